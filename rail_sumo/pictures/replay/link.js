// The address keeps up with the clock, so that a copied one opens the same moment.

const LINK_EVERY_MS = 1000; // browsers let a page change its address about 100 times in 10 s

export class Link {
  /** `now` returns the clock's reading in seconds. */
  constructor(now) {
    this.now = now;
    this.writtenMs = -Infinity;
    this.waiting = false;
  }

  /** The clock has moved: write it into the address, at once or as soon as that is due. */
  follow() {
    if (this.waiting) return;
    const dueMs = this.writtenMs + LINK_EVERY_MS - performance.now();
    if (dueMs <= 0) {
      this._write();
      return;
    }
    this.waiting = true;
    setTimeout(() => {
      this.waiting = false;
      this._write();
    }, dueMs);
  }

  _write() {
    this.writtenMs = performance.now();
    try {
      history.replaceState(null, "", `#t=${this.now().toFixed(1)}`);
    } catch {
      // Within another page's frame the address may not be the page's to change: the film goes on without.
    }
  }
}
