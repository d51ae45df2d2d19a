"""How long functions and files are, and how packages depend on each other: python scripts/code_metrics.py

The import graph is that of `lint-imports`; imports within functions and for types count.
"""

import ast
from collections import Counter
from pathlib import Path

import grimp
import numpy as np

PACKAGE = Path(__file__).parents[1] / "src" / "avrgym"


def main() -> None:
    """Print the figures of docs/explanation/architecture.md."""
    files = {path: path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}
    lengths = {path: len(text.splitlines()) for path, text in files.items()}
    functions = [length for text in files.values() for length in function_lengths(text)]
    print(f"files      {len(files)}, {sum(lengths.values())} lines, the longest:")
    for path, length in sorted(lengths.items(), key=lambda item: -item[1])[:5]:
        print(f"           {length:4d} {path.relative_to(PACKAGE)}")
    usual = np.quantile(functions, 0.9)
    print(f"functions  {len(functions)}, 90 % of up to {usual:.0f} lines, the longest {max(functions)}")
    graph = grimp.build_graph("avrgym", cache_dir=None)
    arrows = {
        (name, used) for name in graph.modules for used in graph.find_modules_directly_imported_by(name)
    }
    between = Counter(
        (package(name), package(used)) for name, used in arrows if package(name) != package(used)
    )
    print(f"imports    {len(arrows)}, {sum(between.values())} of them between packages")
    for name in sorted({name for name, _ in between}):
        used = sorted(to for start, to in between if start == name)
        print(f"           {name:11s} {' '.join(used)}")


def function_lengths(text: str) -> list[int]:
    """Lines of each function, from its ``def`` to its end, docstring included."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    return [
        node.end_lineno - node.lineno + 1
        for node in ast.walk(ast.parse(text))
        if isinstance(node, kinds) and node.end_lineno is not None
    ]


def package(module: str) -> str:
    """The package of the first level that a module belongs to."""
    return module.split(".")[1] if "." in module else module


if __name__ == "__main__":
    main()
