"""Measure the layout of the package: `python tools/house.py [ROOT]` prints the figures that CONTRIBUTING.md lists.

Rooms are flat modules and folders; an arrow is a file of one room that imports a file of another. Every import counts,
those inside functions and those for types alone, too.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

LONG = 60
"""Lines of a function's body from which on it counts as long."""


def name_of(path: Path, package: Path) -> str:
    """The dotted name of a file below the package; a folder's own file has the folder's name."""
    parts = path.relative_to(package).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def imports_of(tree: ast.AST, modules: dict[str, Path]) -> set[str]:
    """Names of modules of the package that a file imports."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayes_damper"):
            above = (node.module or "").removeprefix("bayes_damper").removeprefix(".")
            for alias in node.names:
                inside = f"{above}.{alias.name}".removeprefix(".")
                found.add(inside if inside in modules else above)
    return found - {""}


def bodies(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """(name, lines of the body without its docstring) of each function."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) else node.body
            yield node.name, (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def loose(tree: ast.AST) -> int:
    """How many signatures have `[str, Any]` in them."""
    functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)]
    notes = [[a.annotation for a in ast.walk(f.args) if isinstance(a, ast.arg)] + [f.returns] for f in functions]
    return sum(any(n is not None and "[str, Any]" in ast.unparse(n) for n in each) for each in notes)


def rings(graph: dict[str, set[str]]) -> int:
    """0 where the arrows form no ring, else 1."""
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError:
        return 1
    return 0


def mirrored(root: Path, package: Path) -> float:
    """The share of test modules whose place mirrors that of a module, here or in `validation`, or of a folder's own."""
    tests = [p for p in (root / "tests").rglob("test_*.py") if "prove" not in p.parts]
    modules = [p.relative_to(package) for p in package.rglob("*.py")]
    modules += [p.relative_to(root) for p in (root / "validation").rglob("*.py")]
    folders = {m.parent for m in modules} - {Path()}
    own = {place for p in folders for place in (p, p / p.name)}  # beside the folder's tests, or among them
    places = {p.with_suffix("").as_posix() for p in (*modules, *own)}
    mirror = [t.relative_to(root / "tests").parent / t.stem.removeprefix("test_") for t in tests]
    return sum(place.as_posix() in places for place in mirror) / len(tests)


def measure(root: Path) -> dict[str, str]:
    """Figure -> its value now."""
    package = root / "bayes_damper"
    modules = {name_of(path, package): path for path in sorted(package.rglob("*.py"))}
    trees = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in modules.items()}
    taken = {name: imports_of(tree, modules) for name, tree in trees.items()}
    room = {name: name.split(".")[0] for name in modules}
    between = {(a, room.get(b, b)) for a, names in taken.items() for b in names if room.get(b, b) != room[a]}
    rooms: dict[str, set[str]] = {}
    for name, target in between:
        if room[name] not in {"__init__", "__main__", "cli"}:
            rooms.setdefault(room[name], set()).add(target)
    folders = {p.parent for p in modules.values()} - {package}
    inner = 0
    for folder in folders:
        own = {name for name, path in modules.items() if path.parent == folder}
        inner += rings({name: taken[name] & own - {name} for name in own})
    long = sorted(((n, name) for tree in trees.values() for name, n in bodies(tree) if n > LONG), reverse=True)
    classes = [
        (n.end_lineno or 0) - n.lineno + 1 for t in trees.values() for n in ast.walk(t) if isinstance(n, ast.ClassDef)
    ]
    flat = {p.stem for p in package.glob("*.py")} - {"__init__", "__main__"}
    return {
        "flat modules": str(len(flat)),
        "rooms (flat modules and folders)": str(len(set(room.values()) - {"__init__", "__main__"})),
        "arrows between rooms": str(len({(room[a], b) for a, b in between})),
        "import rings between rooms; inside folders": f"{rings(rooms)}; {inner}",
        f"function bodies above {LONG} lines": f"{len(long)} ({', '.join(f'{name} {n}' for n, name in long[:4])})",
        "largest class, lines": str(max(classes)),
        "signatures with [str, Any]": str(sum(map(loose, trees.values()))),
        "lines of the package": str(sum(len(p.read_text(encoding="utf-8").splitlines()) for p in modules.values())),
        "tests in the place of their module": f"{mirrored(root, package):.0%}",
    }


if __name__ == "__main__":
    home = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent.parent
    for what, value in measure(home).items():
        print(f"{what:<46}{value}")
