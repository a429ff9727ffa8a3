"""A window that shows frames as they come. Needs pygame, the extra `render`."""

from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rail_sumo.errors import InputError


def require_pygame() -> None:
    """Raise InputError if pygame is not installed."""
    if find_spec("pygame") is None:
        raise InputError("a window needs pygame; install it with: pip install 'rail-sumo[render]'")


class Window:
    """Opens with the first frame. Once its user has closed it, it shows no more.

    Args:
        title: what its frame says.
        frames_per_s: how many frames it shows in a second at most; it waits for that.
    """

    def __init__(self, title: str, frames_per_s: float) -> None:
        self._title = title
        self._wait_ms = round(1000.0 / frames_per_s)
        self._shown_at_ms: int | None = None
        self._screen: Any = None
        self.is_closed = False

    def show(self, pixels: NDArray[np.uint8]) -> None:
        """Show a frame, shape (height, width, 3), once the one before has been shown for its time."""
        if self.is_closed:
            return
        import pygame

        if self._screen is None:
            pygame.display.init()
            pygame.display.set_caption(self._title)
            self._screen = pygame.display.set_mode((pixels.shape[1], pixels.shape[0]))
        if self._shown_at_ms is not None:
            pygame.time.wait(max(0, self._shown_at_ms + self._wait_ms - pygame.time.get_ticks()))
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        self._screen.blit(pygame.surfarray.make_surface(pixels.transpose(1, 0, 2)), (0, 0))
        pygame.display.flip()
        self._shown_at_ms = pygame.time.get_ticks()

    def close(self) -> None:
        """Close it; harmless when it is not open."""
        self.is_closed = True
        if self._screen is not None:
            import pygame

            pygame.display.quit()
            self._screen = None
