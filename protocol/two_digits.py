"""How large an error is, in words for people: two digits tell it."""


def two_digits(value: float) -> str:
    """A number rounded to two digits that count, written out: 180, where `.2g` makes 1.8e+02."""
    return f"{float(f'{value:.2g}'):g}"
