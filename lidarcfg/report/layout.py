"""Where axes stand in a figure: their labels have known sizes, so nothing has to be drawn to measure them.

Lengths are in ems of the font, that of the default style or of another one in use.
"""

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure

TICK, DIGITS, PAD, TEXT = 0.8, 2.6, 0.45, 1.2  # a tick and its gap, four digits beside an axis, a gap, a line of text
LEFT = TICK + DIGITS + PAD + TEXT + 0.2  # of axes: ticks, their labels, and what they count
BELOW = TICK + 1.0 + PAD + TEXT + 0.2
ABOVE = 2.0  # axes with a title
EDGE = 1.3  # for half a number at the end of an axis
BAR_GAP, BAR = 1.2, 0.9  # beside axes with a colour bar
BESIDE = BAR_GAP + BAR + LEFT  # the bar, and its labels
ADVANCE = {"−": 0.84, ".": 0.32, ",": 0.32, " ": 0.32}  # of characters; digits have DIGIT
DIGIT = 0.64


def em_in() -> float:
    """An em in inches."""
    import matplotlib as mpl

    return float(mpl.rcParams["font.size"]) / 72


def spaces(
    figure: "Figure",
    widths: Sequence[float] = (1,),
    heights: Sequence[float] = (1,),
    *,
    right: float = EDGE,
    above: float = EDGE,
    across: float = LEFT + EDGE,
    down: float = BELOW + ABOVE,
) -> dict[str, Any]:
    """The options of a grid of axes of these relative widths and heights, with space on its sides and between them."""
    figure.set_layout_engine(None)
    width, height = figure.get_size_inches() / em_in()
    columns, rows = len(widths), len(heights)
    return {
        "width_ratios": widths,
        "height_ratios": heights,
        "left": LEFT / width,
        "right": 1 - right / width,
        "bottom": BELOW / height,
        "top": 1 - above / height,
        "wspace": across * columns / (width - LEFT - right - across * (columns - 1)),
        "hspace": down * rows / (height - BELOW - above - down * (rows - 1)),
    }


def color_bar(figure: "Figure", image: Any, beside: Sequence["Axes"], label: str) -> "Colorbar":
    """A colour bar on the right of axes."""
    boxes = [axes.get_position() for axes in beside]
    em = em_in() / figure.get_figwidth()
    low, high = min(box.y0 for box in boxes), max(box.y1 for box in boxes)
    place = (max(box.x1 for box in boxes) + BAR_GAP * em, low, BAR * em, high - low)
    return figure.colorbar(image, cax=figure.add_axes(place), label=label)


def place_labels(figure: "Figure") -> None:
    """Put the axes' labels beside those of their ticks; axes whose ticks have long ones make room for them."""
    from matplotlib.transforms import ScaledTranslation

    em = em_in()
    more: dict[float, float] = defaultdict(float)  # by the left edge of axes, so that what is aligned stays so
    for axes in figure.axes:
        x = TICK + _widest(axes.yaxis) + PAD
        side: str = axes.yaxis.get_label_position()
        if side == "left":
            left = axes.get_position(original=True).x0
            more[left] = max(more[left], x - (TICK + DIGITS + PAD))
            x = -x
        beside = ScaledTranslation(x * em, 0, figure.dpi_scale_trans)
        axes.yaxis.set_label_coords(float(x > 0), 0.5, axes.transAxes + beside)
        below = ScaledTranslation(0, -(TICK + 1.0 + PAD) * em, figure.dpi_scale_trans)
        axes.xaxis.set_label_coords(0.5, 0, axes.transAxes + below)
    for axes in figure.axes:
        box = axes.get_position(original=True)
        if wider := more[box.x0] * em / figure.get_figwidth():
            axes.set_position((box.x0 + wider, box.y0, box.width - wider, box.height))


def _widest(axis: "Axis") -> float:
    """The width of the longest label of an axis's ticks."""
    shown = axis.get_tick_params()
    if not (shown.get("labelleft") or shown.get("labelright")):
        return 0.0
    low, high = sorted(axis.get_view_interval())
    places = axis.get_majorticklocs().tolist()
    texts = axis.get_major_formatter().format_ticks(places)
    return max((_width(text) for text, at in zip(texts, places, strict=True) if low <= at <= high), default=0.0)


def _width(text: str) -> float:
    return sum(ADVANCE.get(character, DIGIT) for character in text)
