"""The tables of docs/zoo.md: python research/zoo_tables.py"""

from avrgym.people.zoo.partners import SINGLE_STYLE_SETS, ZOOS
from avrgym.people.zoo.styles import STYLES, Style

AXES = ("delay", "amplitude", "tempo")


def style_rows() -> list[str]:
    """What each style does, and the sources."""
    return [f"| `{name}` | {style.does} | {style.source} |" for name, style in STYLES.items()]


def range_rows() -> list[str]:
    """What each style moves along each axis, and how many partners it has to train with and unseen."""
    return [
        f"| `{name}` | {' | '.join(_ranges(style, axis) for axis in AXES)} | {_counts(name)} |"
        for name, style in STYLES.items()
    ] + [f"| all | | | | {' + '.join(str(len(partners)) for partners in ZOOS.values())} |"]


def _ranges(style: Style, axis: str) -> str:
    return ", ".join(f"{trait} {first:g}–{last:g}" for trait, (first, last) in getattr(style, axis).items())


def _counts(name: str) -> str:
    return " + ".join(str(len(SINGLE_STYLE_SETS[f"{zoo}/{name}"])) for zoo in ZOOS)


if __name__ == "__main__":
    print("\n".join([*style_rows(), "", *range_rows()]))
