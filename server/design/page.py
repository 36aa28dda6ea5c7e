"""A page of lines, circles and words in mm, written as SVG and as PDF, both true to scale.

Origin at the lower left corner of the page, x right, y up. Words are set in the two faces that every viewer has:
Helvetica for sentences, Courier for columns of numbers, whose width is known.
"""

from dataclasses import dataclass
from xml.sax.saxutils import escape

MM_PER_POINT = 25.4 / 72.0
_ARC = 0.5522847498  # of the radius: control points of a quarter circle as a cubic curve
_COURIER = 0.6  # width of a character, of the size


@dataclass(frozen=True, slots=True)
class Line:
    """From one point to another, mm."""

    x0: float
    y0: float
    x1: float
    y1: float
    width: float = 0.15


@dataclass(frozen=True, slots=True)
class Circle:
    """An outline, mm."""

    x: float
    y: float
    radius: float
    width: float = 0.15


@dataclass(frozen=True, slots=True)
class Disc:
    """All black, mm."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True, slots=True)
class Rectangles:
    """One black area, so that no seams show between neighbours: x, y of the lower left corners, widths, heights, mm."""

    each: tuple[tuple[float, float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Words:
    """One line of plain ASCII text that begins at x on the base line y, mm; ``columns``: in Courier."""

    x: float
    y: float
    text: str
    size: float = 3.2  # mm
    columns: bool = False

    def __post_init__(self) -> None:
        assert self.text.isascii(), f"{self.text!r}: both writers are for ASCII"


Mark = Line | Circle | Disc | Rectangles | Words


@dataclass(frozen=True, slots=True)
class Page:
    """What is on it; width and height in mm."""

    width: float
    height: float
    title: str
    marks: tuple[Mark, ...]


def columns_width(text: str, size: float) -> float:
    """Of words in Courier, mm."""
    return _COURIER * size * len(text)


def svg(page: Page) -> str:
    """The page as SVG 1.1: one user unit is one mm, and the size says so."""
    width, height = _number(page.width), _number(page.height)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}mm" height="{height}mm" '
        f'viewBox="0 0 {width} {height}">',
        f"<title>{escape(page.title)}</title>",
        f'<rect width="{width}" height="{height}" fill="white"/>',
        '<g fill="none" stroke="black">',
    ]
    words = []
    for mark in page.marks:
        if isinstance(mark, Line):
            x0, y0, x1, y1 = (_number(v) for v in (mark.x0, page.height - mark.y0, mark.x1, page.height - mark.y1))
            lines.append(f'<line x1="{x0}" y1="{y0}" x2="{x1}" y2="{y1}" stroke-width="{_number(mark.width)}"/>')
        elif isinstance(mark, Circle):
            x, y, r = _number(mark.x), _number(page.height - mark.y), _number(mark.radius)
            lines.append(f'<circle cx="{x}" cy="{y}" r="{r}" stroke-width="{_number(mark.width)}"/>')
        elif isinstance(mark, Disc):
            x, y, r = _number(mark.x), _number(page.height - mark.y), _number(mark.radius)
            lines.append(f'<circle cx="{x}" cy="{y}" r="{r}" fill="black" stroke="none"/>')
        elif isinstance(mark, Rectangles):
            path = " ".join(
                f"M{_numbers(x, page.height - y)} h{_number(w)} v{_number(-h)} h{_number(-w)} z"
                for x, y, w, h in mark.each
            )
            lines.append(f'<path d="{path}" fill="black" stroke="none"/>')
        else:
            family = "Courier, 'Courier New', monospace" if mark.columns else "Helvetica, Arial, sans-serif"
            words.append(
                f'<text x="{_number(mark.x)}" y="{_number(page.height - mark.y)}" font-size="{_number(mark.size)}" '
                f'font-family="{family}" xml:space="preserve">{escape(mark.text)}</text>'
            )
    return "\n".join([*lines, "</g>", *words, "</svg>", ""])


def pdf(page: Page) -> bytes:
    """The page as PDF 1.4 (ISO 32000-1): a content stream in mm, scaled to points once."""
    scale = f"{1.0 / MM_PER_POINT:.8f}"
    drawn = [f"{scale} 0 0 {scale} 0 0 cm"]
    for mark in page.marks:
        if isinstance(mark, Line):
            drawn.append(f"{_numbers(mark.width)} w {_numbers(mark.x0, mark.y0)} m {_numbers(mark.x1, mark.y1)} l S")
        elif isinstance(mark, Circle):
            drawn.append(f"{_numbers(mark.width)} w {_circle(mark.x, mark.y, mark.radius)} S")
        elif isinstance(mark, Disc):
            drawn.append(f"{_circle(mark.x, mark.y, mark.radius)} f")
        elif isinstance(mark, Rectangles):
            drawn.append(" ".join(f"{_numbers(*rectangle)} re" for rectangle in mark.each) + " f")
        else:
            text = mark.text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
            face = "F2" if mark.columns else "F1"
            drawn.append(f"BT /{face} {_numbers(mark.size)} Tf {_numbers(mark.x, mark.y)} Td ({text}) Tj ET")
    stream = "\n".join(drawn).encode("ascii")
    box = _numbers(page.width / MM_PER_POINT, page.height / MM_PER_POINT)
    title = page.title.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {box}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R /F2 6 0 R >> >> >>".encode("ascii"),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(stream), stream),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Courier >>",
        f"<< /Title ({title}) /Producer (asterism) >>".encode("ascii"),
    ]
    out = bytearray(b"%PDF-1.4\n")
    places = []
    for number, body in enumerate(objects, start=1):
        places.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    start = len(out)
    out += b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1)
    out += b"".join(b"%010d 00000 n \n" % place for place in places)
    out += b"trailer\n<< /Size %d /Root 1 0 R /Info %d 0 R >>\n" % (len(objects) + 1, len(objects))
    out += b"startxref\n%d\n%%%%EOF\n" % start
    return bytes(out)


def _circle(x: float, y: float, r: float) -> str:
    c = _ARC * r
    parts = [f"{_numbers(x + r, y)} m"]
    for points in (
        (x + r, y + c, x + c, y + r, x, y + r),
        (x - c, y + r, x - r, y + c, x - r, y),
        (x - r, y - c, x - c, y - r, x, y - r),
        (x + c, y - r, x + r, y - c, x + r, y),
    ):
        parts.append(f"{_numbers(*points)} c")
    return " ".join(parts)


def _numbers(*values: float) -> str:
    return " ".join(_number(value) for value in values)


def _number(value: float) -> str:
    """To a tenth of a micrometre, without exponent."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
