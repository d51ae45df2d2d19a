"""Prints the size of code and pages, and dependencies between packages: python scripts/code_metrics.py

Sizes are of files that git tracks. The import graph is that of `lint-imports`; imports within functions and for types
count.
"""

import ast
import subprocess
from collections import Counter
from pathlib import Path

import grimp
import numpy as np

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "avrgym"
SIZES = {
    "Python": (("src",), ".py"),
    "tests": (("tests",), ".py"),
    "scripts": (("scripts", "research", "examples"), ".py"),
    "TypeScript": (("client/src",), ".ts"),
    "client tests": (("client/tests",), ".ts"),
}
"""Folders and endings of each kind of code."""


def main() -> None:
    """Print every metric."""
    for name, (folders, ending) in SIZES.items():
        files = [ROOT / file for file in tracked(*folders) if file.endswith(ending)]
        lines = sum(len(file.read_text("utf-8").splitlines()) for file in files)
        print(f"{name:13s} {lines:6d} lines in {len(files):3d} files")
    pages = [file for file in ("README.md", *tracked("docs")) if file.endswith(".md")]
    words = sum(len((ROOT / file).read_text("utf-8").split()) for file in pages)
    print(f"{'pages':13s} {words:6d} words in {len(pages):3d} files, generated parts not counted")
    print_functions()
    print_imports()


def tracked(*folders: str) -> list[str]:
    """The files in some folders that git tracks, as far as they exist."""
    found = subprocess.run(
        ["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return [file for file in found.stdout.splitlines() if (ROOT / file).is_file()]


def print_functions() -> None:
    """Print the longest files, and the lengths of functions."""
    files = {path: path.read_text("utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    lengths = {path: len(text.splitlines()) for path, text in files.items()}
    for path, length in sorted(lengths.items(), key=lambda item: -item[1])[:5]:
        print(f"{'':13s} {length:6d} {path.relative_to(PACKAGE)}")
    functions = [length for text in files.values() for length in function_lengths(text)]
    print(
        f"functions     {len(functions):6d}, median {np.median(functions):.0f} lines, "
        f"90 % up to {np.quantile(functions, 0.9):.0f}, longest {max(functions)}"
    )


def function_lengths(text: str) -> list[int]:
    """Lines of each function, from its ``def`` to its end, docstring included."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    return [
        node.end_lineno - node.lineno + 1
        for node in ast.walk(ast.parse(text))
        if isinstance(node, kinds) and node.end_lineno is not None
    ]


def print_imports() -> None:
    """Print which package imports which."""
    graph = grimp.build_graph("avrgym", cache_dir=None)
    imports = {
        (name, used) for name in graph.modules for used in graph.find_modules_directly_imported_by(name)
    }
    between = Counter(
        (package(name), package(used)) for name, used in imports if package(name) != package(used)
    )
    print(f"imports       {len(imports):6d}, {sum(between.values())} of them between packages")
    for name in sorted({name for name, _ in between}):
        used = sorted(to for start, to in between if start == name)
        print(f"{'':13s} {name:14s} {' '.join(used)}")


def package(module: str) -> str:
    """The first-level package of a module."""
    return module.split(".")[1] if "." in module else module


if __name__ == "__main__":
    main()
