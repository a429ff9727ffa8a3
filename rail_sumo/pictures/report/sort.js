// A click on a column's heading sorts its table by it: numbers as numbers, words as words; a second click turns it round.
const valueIn = (row, column) => {
  const cell = row.cells[column];
  return cell.dataset.value ?? cell.textContent.trim();
};

const compare = (one, other) => {
  const [a, b] = [Number(one), Number(other)];
  const areNumbers = one !== "" && other !== "" && !Number.isNaN(a) && !Number.isNaN(b);
  return areNumbers ? a - b : one.localeCompare(other);
};

for (const table of document.querySelectorAll("table.sortable")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...heading.childNodes);
    heading.append(button);
    button.addEventListener("click", () => {
      const isUp = heading.getAttribute("aria-sort") !== "ascending";
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", isUp ? "ascending" : "descending");
      const rows = [...table.tBodies[0].rows];
      rows.sort((one, other) => compare(valueIn(one, column), valueIn(other, column)) * (isUp ? 1 : -1));
      table.tBodies[0].append(...rows);
    });
  });
}
