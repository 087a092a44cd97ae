"""The printed report."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from statistics import median

from contest import Measured
from rows import Row

CAPTION = """\
Ratios are kinegrad / PyTorch: below 1, kinegrad is faster or smaller. Time: median of the ratios of
{threads}-thread steps done in turn (least to greatest); seconds are medians. Rounds in which other work
took part of the machine are left out, or marked where there is no other. Memory in MiB: `peak` is
the largest resident set over the steps; `counted` is that less the set after start-up and, where
weights are trained, less 16 bytes a parameter (weights, gradients and two moments) or 20 (a moving
average as well, in the rows of GMD). The memory of
`e2e_checkpointed` is compared with PyTorch's in mode `full`. Difference: of the losses, the first
one and the largest of all; of samples, the largest against the largest value.
{versions}"""

GPU_CAPTION = """\
On a GPU, `peak` is the device memory that grew while only this process worked (its context
included), and `counted` is that less 16 or 20 bytes a parameter where weights are trained."""


@dataclass
class Result:
    """One row against one form of PyTorch."""

    row: str
    against: str
    time_ratio: float
    spread: tuple[float, float]
    """Least and greatest ratio of one round."""
    memory_ratio: float | None
    memory_against: str
    """The row of PyTorch's memory."""
    memory_ratio_same_row: float | None
    rounds: int
    seconds: tuple[float, float]
    """kinegrad's, PyTorch's."""
    peak_mib: tuple[float | None, float | None]
    counted_mib: tuple[float | None, float | None]
    """PyTorch's is of this row."""
    parameters: int
    first_difference: float | None
    difference: float
    document_seconds: float | None
    quiet: bool
    """True if the machine was quiet in these rounds."""

    @classmethod
    def of(cls, row: Row, measured: Measured, against: str, reference: float | None) -> "Result":
        """kinegrad against one form of PyTorch, whose counted memory to compare with is
        `reference`."""
        ours, theirs = measured.sides["kinegrad"], measured.sides[against]
        ratios = [a / b for a, b in zip(ours.seconds, theirs.seconds, strict=True)]
        counted = (ours.counted_mib(row), theirs.counted_mib(row))
        first = None
        if row.trains:
            first = abs(ours.losses[0] - theirs.losses[0]) / abs(theirs.losses[0])
        return cls(
            row=row.name,
            against=against,
            time_ratio=median(ratios),
            spread=(min(ratios), max(ratios)),
            memory_ratio=ratio(counted[0], reference),
            memory_against=row.memory_against or row.name,
            memory_ratio_same_row=ratio(*counted),
            rounds=len(ratios),
            seconds=(median(ours.seconds), median(theirs.seconds)),
            peak_mib=(ours.peak_mib, theirs.peak_mib),
            counted_mib=counted,
            parameters=ours.parameters,
            first_difference=first,
            difference=measured.differences[against],
            document_seconds=row.document_seconds,
            quiet=measured.quiet,
        )

    def record(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)

    def line(self) -> str:
        """In short, as progress."""
        low, high = self.spread
        return (
            f"{self.row}: time {self.time_ratio:.2f} ({low:.2f} to {high:.2f}) of {self.against}'s, "
            f"memory {number(self.memory_ratio, '.2f')}"
        )


def ratio(ours: float | None, theirs: float | None) -> float | None:
    """The ratio of two numbers, if defined."""
    return None if ours is None or theirs is None or theirs <= 0 else ours / theirs


def table(results: list[Result], rows: list[Row]) -> str:
    """The comparison as markdown."""
    what = {row.name: row.what for row in rows}
    header = ["row", "", "against", "rounds", "s", "time ratio", "peak", "counted", "memory ratio"]
    lines = [[*header, "difference"], ["---"] * 3 + ["---:"] * 7]
    for r in results:
        low, high = r.spread
        first = "" if r.first_difference is None else f"{r.first_difference:.0e}, "
        lines.append(
            [
                f"`{r.row}`",
                what[r.row],
                r.against,
                str(r.rounds) if r.quiet else f"{r.rounds}, disturbed",
                pair(r.seconds, ".3f"),
                f"**{r.time_ratio:.2f}** ({low:.2f} to {high:.2f})",
                pair(r.peak_mib, ".0f"),
                pair(r.counted_mib, ".0f"),
                f"**{number(r.memory_ratio, '.2f')}**",
                f"{first}{r.difference:.0e}",
            ]
        )
    return markdown(lines)


def document_table(results: list[Result]) -> str | None:
    """Sampling times and those that CC-MotionGen claims, if measured."""
    measured = [r for r in results if r.document_seconds is not None]
    if not measured:
        return None
    lines = [["row", "kinegrad s", "PyTorch s", "CC-MotionGen, CPU s"], ["---", *["---:"] * 3]]
    for r in measured:
        ours, theirs = r.seconds
        lines.append([f"`{r.row}`", f"{ours:.2f}", f"{theirs:.2f}", f"{r.document_seconds:.1f}"])
    return markdown(lines)


def pair(values: Iterable[float | None], form: str) -> str:
    """kinegrad's and PyTorch's."""
    return " / ".join(number(value, form) for value in values)


def number(value: float | None, form: str) -> str:
    """A number, or a dash."""
    return "-" if value is None else format(value, form)


def markdown(lines: list[list[str]]) -> str:
    """A table of cells."""
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
