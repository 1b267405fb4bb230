"""Which runs are computed next, in chunks that grow to about a second, and what follows a death."""

from collections import deque
from collections.abc import Iterator, Sequence
from threading import Condition

Range = tuple[int, int]  # first run and number of runs: a power of two that divides the first

TARGET = 1.0  # s, of one chunk
LARGEST = 1 << 13  # runs
CHUNK_NUMBERS = 1 << 21  # of one chunk, in memory


def gaps(total: int, finished: Sequence[Range]) -> list[Range]:
    """Return first and end of what is not finished; refuses nothing that overlaps."""
    found, at = [], 0
    for first, count in sorted(finished):
        if first > at:
            found.append((at, first))
        at = max(at, first + count)
    return [*found, *([(at, total)] if at < total else [])]


def aligned(first: int, end: int, most: int = LARGEST) -> Iterator[Range]:
    """Yield the fewest chunks, of at most that many runs, from `first` up to `end`."""
    while first < end:
        count = min(most, 1 << (end - first).bit_length() - 1)
        if first:
            count = min(count, first & -first)
        yield first, count
        first += count


class Schedule:
    """The chunks that are left, shared by the threads that wait for workers.

    Args:
        left: First and end of what is to be computed.
        workers: How many processes there are.
        size: Runs of a chunk where the user has fixed it, rounded down to a power of two.
        smallest: Runs of a chunk that are worth a call.
    """

    def __init__(
        self, left: Sequence[Range], workers: int, size: int | None, smallest: int
    ) -> None:
        self._fresh = deque(left)
        self._again: deque[Range] = deque()
        self._deaths: dict[Range, int] = {}
        self._returns: dict[Range, int] = {}
        self._running: set[Range] = set()
        self._news = Condition()
        self._workers = workers
        self._fixed = size is not None
        self._smallest = smallest
        self._size = 1 << (size or smallest).bit_length() - 1
        self._stopped = False

    def take(self, *, wait: bool = True) -> Range | None:
        """Return the next chunk; None when there is none, for ever or (without `wait`) just now."""
        with self._news:
            while not self._stopped:
                if self._again or self._fresh:
                    chunk = self._again.popleft() if self._again else self._cut()
                    self._running.add(chunk)
                    return chunk
                if not self._running or not wait:
                    return None
                self._news.wait()
        return None

    @property
    def over(self) -> bool:
        """Whether nothing is left and nothing is under way."""
        with self._news:
            return not (self._again or self._fresh or self._running)

    def stop(self) -> None:
        """Give out nothing more."""
        with self._news:
            self._stopped = True
            self._news.notify_all()

    def done(self, chunk: Range, numbers: int, seconds: float) -> None:
        """Note that a chunk is written, how many numbers it computed and how long it took."""
        with self._news:
            self._running.discard(chunk)
            count = chunk[1]
            if not self._fixed and seconds > 0:
                rate = count / seconds * TARGET
                fits = CHUNK_NUMBERS * count // max(numbers, 1)
                wanted = int(max(1, min(rate, fits, 4 * self._size, LARGEST)))
                self._size = max(1 << wanted.bit_length() - 1, min(self._smallest, max(1, fits)))
                self._size = 1 << self._size.bit_length() - 1
            self._news.notify_all()

    def died(self, chunk: Range, at: int | None, *, killed: bool = False) -> int | None:
        """Note that a process died with a chunk; return the run that is given up, if one is.

        A run at which two processes died is; where they were killed from outside, it has to be
        alone for both.

        Args:
            chunk: What it computed.
            at: The run that it had begun, where that is known: it goes on alone.
            killed: Whether somebody ended the process, for which the run need not be to blame.
        """
        first, count = chunk
        with self._news:
            self._running.discard(chunk)
            if chunk in self._again:  # it came back before
                self._again.remove(chunk)
            deaths = self._deaths.pop(chunk, 0) + 1
            self._news.notify_all()
            if count == 1:
                if deaths > 1:
                    return first
                self._deaths[chunk] = deaths
                self._again.append(chunk)
            elif at is not None and first <= at < first + count:
                end = first + count
                if not killed:
                    self._deaths[at, 1] = 1
                self._again.extend([(at, 1), *aligned(first, at), *aligned(at + 1, end)])
            elif deaths > 1:
                halves = [(first, count // 2), (first + count // 2, count // 2)]
                self._deaths |= dict.fromkeys(halves, 1)
                self._again.extend(halves)
            else:
                self._deaths[chunk] = deaths
                self._again.append(chunk)
        return None

    def given_up(self, chunk: Range) -> int:
        """Note that a chunk comes back without having begun; return how often in all."""
        with self._news:
            self._running.discard(chunk)
            if chunk not in self._again:
                self._again.append(chunk)
            self._returns[chunk] = self._returns.get(chunk, 0) + 1
            self._news.notify_all()
            return self._returns[chunk]

    def _cut(self) -> Range:
        first, end = self._fresh.popleft()
        size = self._size
        if not self._fixed:  # the last chunks are small, so that all workers end together
            share = (end - first) // (2 * self._workers)
            size = max(min(size, 1 << max(share, 1).bit_length() - 1), min(self._smallest, size))
        chunk = next(aligned(first, end, size))
        if first + chunk[1] < end:
            self._fresh.appendleft((first + chunk[1], end))
        return chunk
