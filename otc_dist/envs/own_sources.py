"""Which source files a user's module consists of, and their digests: with another, other results.

These are the module named, and all that it imports from its own folder, or that anything there
does, wherever in the text the import stands; and what else of that folder was loaded when the
environment was made. Of an installed package, its own folder is the package.
"""

import ast
import hashlib
import site
import sys
import sysconfig
from collections.abc import Collection, Iterator
from pathlib import Path, PurePath


def digests(module: str, loaded: Collection[str]) -> dict[str, str]:
    """SHA-256 of each file, by its path from the folder in which Python found the module.

    Args:
        module: a name that can be imported.
        loaded: names of modules that came with it when it was imported and used; those of other
            folders are left out.
    """
    named = _file(module)
    if named is None:  # a namespace, or built in
        return {}
    root = named.parents[module.count(".") + (named.stem == "__init__")]
    inside, others = root, _installed()
    if root in others:
        inside, others = root / module.partition(".")[0], set()
    found, waiting = set[Path](), [named]
    for name in loaded:
        file = _file(name)
        if file is not None and name.partition(".")[0] != "otc_dist":
            waiting.append(file)
    while waiting:
        file = waiting.pop()
        foreign = any(file.is_relative_to(place) for place in others)
        if file != named and (file in found or foreign or not file.is_relative_to(inside)):
            continue
        found.add(file)
        if file.suffix == ".py":
            waiting += [other for other in _imported(file, root) if other not in found]
    return {
        file.relative_to(root).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(found)
    }


def _file(name: str) -> Path | None:
    """The file of a module that was imported; None if there is none, whatever the module says."""
    file_name = getattr(sys.modules.get(name), "__file__", None)
    file = Path(file_name).absolute() if file_name else None
    return file if file and file.is_file() else None


def _installed() -> set[Path]:
    """The folders in which packages are installed, each beside all others."""
    usual = (sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib"))
    paths = [*usual, *site.getsitepackages(), site.getusersitepackages()]
    return {Path(path).absolute() for path in paths}


def _imported(file: Path, root: Path) -> Iterator[Path]:
    """The files below `root` that the import statements of `file` may mean."""
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):  # it cannot have been imported
        return
    package = file.relative_to(root).parent
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _files(root, PurePath(*alias.name.split(".")))
        elif isinstance(node, ast.ImportFrom):
            if node.level > len(package.parts) + 1:
                continue
            above = PurePath(*package.parts[: len(package.parts) - node.level + 1])
            base = above if node.level else PurePath()
            base = base.joinpath(*(node.module or "").split("."))
            for alias in node.names:
                yield from _files(root, base / alias.name)


def _files(root: Path, name: PurePath) -> Iterator[Path]:
    """The files of a module, `a/b/c`, and of the packages that hold it, as far as there are any."""
    for end in range(1, len(name.parts) + 1):
        place = root.joinpath(*name.parts[:end])
        for file in (place / "__init__.py", place.with_name(f"{place.name}.py")):
            if file.is_file():
                yield file
