"""How a figure is written in a page."""


def number(value: float) -> str:
    """Return a figure with three significant digits, without an exponent."""
    return f"{float(f'{value:.3g}'):g}"
