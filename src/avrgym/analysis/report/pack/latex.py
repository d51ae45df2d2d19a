"""Tables for LaTeX, with the package booktabs."""

from collections.abc import Sequence

SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$", "×": r"$\times$", "–": "--",
    "<": "$<$", ">": "$>$",
}  # fmt: skip


def escaped(text: object) -> str:
    """Text as LaTeX prints it."""
    return "".join(SPECIAL.get(letter, letter) for letter in str(text))


def latex_table(
    caption: str, heads: Sequence[str], rows: Sequence[Sequence[object]], numbers: Sequence[int]
) -> str:
    """A table as ``page.table`` shows it; ``numbers`` are the columns to align at their ends."""
    columns = "".join("r" if column in numbers else "l" for column in range(len(heads)))
    lines = [" & ".join(escaped(cell) for cell in row) + r" \\" for row in (heads, *rows)]
    return "\n".join(
        [
            r"\begin{table}",
            rf"\caption{{{escaped(caption)}}}",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            lines[0],
            r"\midrule",
            *lines[1:],
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )
