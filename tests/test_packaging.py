"""The package is whole, starts at once, and says in its docs what it offers."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

HEAVY = ("jax", "numpyro", "polars", "matplotlib", "arviz", "xarray", "scipy", "pyproj")


def _public_modules(root: Path) -> list[Path]:
    """Every public module's file: no part of its dotted name starts with an underscore."""
    files = [*(root / "maloc").rglob("*.py"), *(root / "models").glob("*.py")]
    return [
        f
        for f in files
        if not any(
            part.startswith("_") and part != "__init__.py" for part in f.relative_to(root).parts
        )
        and f.relative_to(root).parts[:2] != ("maloc", "models")
    ]


def _module_name(file: Path, root: Path) -> str:
    parts = list(file.relative_to(root).with_suffix("").parts)
    if parts[0] == "models":
        parts.insert(0, "maloc")
    return ".".join(p for p in parts if p != "__init__")


def _declared_all(file: Path) -> list[str] | None:
    for node in ast.parse(file.read_text(encoding="utf-8")).body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        if isinstance(node, ast.AnnAssign):
            targets = [node.target]
        if any(isinstance(t, ast.Name) and t.id == "__all__" for t in targets):
            assert isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
            return list(ast.literal_eval(node.value))
    return None


def test_every_package_is_in_the_wheel(root_dir: Path):
    """A package missing from the list would vanish from the wheel without a word."""
    config = tomllib.loads((root_dir / "pyproject.toml").read_text())
    listed = config["tool"]["setuptools"]["packages"]
    files = [*(root_dir / "maloc").rglob("*.py"), *(root_dir / "models").rglob("*.py")]
    homes = {file.parent.relative_to(root_dir).parts for file in files}
    found = {".".join(p if p[0] == "maloc" else ("maloc", *p)) for p in homes}
    assert sorted(listed) == sorted(found)


def test_one_version(root_dir: Path):
    """What is built has the package's own; the papers of a release name the same."""
    import maloc

    config = tomllib.loads((root_dir / "pyproject.toml").read_text())
    assert config["tool"]["setuptools"]["dynamic"]["version"] == {
        "attr": "maloc._package.version.__version__"
    }
    citation = (root_dir / "CITATION.cff").read_text()
    assert f"version: {maloc.__version__}\n" in citation
    changes = (root_dir / "CHANGELOG.md").read_text()
    latest, dated = re.findall(r"^## (\S+) \((\S+)\)$", changes, flags=re.M)[0]
    assert latest == maloc.__version__ and f"date-released: {dated}\n" in citation


@pytest.mark.parametrize(
    "statement",
    [
        "import maloc",
        "import maloc.errors",
        "import sys, maloc.cli; sys.argv = ['maloc', '--help']; maloc.cli.main()",
        "import sys, maloc.cli; sys.argv = ['maloc', 'track', '--help']; maloc.cli.main()",
    ],
)
def test_starts_without_heavy_imports(statement: str):
    """The cause of a slow start, not the clock: what is in sys.modules afterwards."""
    code = f"""
import sys
try:
    exec({statement!r})
except SystemExit as end:
    assert not end.code, end.code
loaded = sorted(set({HEAVY!r}) & set(sys.modules))
sys.exit(f"loaded: {{loaded}}" if loaded else 0)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr + done.stdout


def test_lazy_names_all_resolve():
    import maloc

    for name in maloc.__all__:
        assert getattr(maloc, name) is not None
    assert set(maloc.__all__) <= set(dir(maloc))
    with pytest.raises(AttributeError, match="no_such_name"):
        maloc.no_such_name  # type: ignore[attr-defined]  # noqa: B018


def test_typed_names_are_the_lazy_names(root_dir: Path):
    """What type checkers see under TYPE_CHECKING is what __all__ offers at run time."""
    import maloc

    tree = ast.parse((root_dir / "maloc" / "__init__.py").read_text())
    guard = next(n for n in tree.body if isinstance(n, ast.If))
    names = [a.name for n in guard.body if isinstance(n, ast.ImportFrom) for a in n.names]
    assert sorted(names) == sorted(maloc.__all__)


def test_every_public_module_says_what_it_offers(root_dir: Path):
    missing = [
        _module_name(f, root_dir)
        for f in _public_modules(root_dir)
        if _declared_all(f) is None and f.read_text(encoding="utf-8").strip()
    ]
    assert missing == []


def test_api_page_lists_the_public_names(root_dir: Path):
    """docs/api.md and __all__ of each package of the interface name the same things."""
    page = (root_dir / "docs" / "api.md").read_text(encoding="utf-8")
    sections = re.split(r"^## ", page, flags=re.M)[1:]
    listed = {
        s.split("\n", 1)[0].strip().strip("`"): set(re.findall(r"^\| `(\w+)", s, flags=re.M))
        for s in sections
    }
    handed_on = {
        f"maloc.{room}.{name}"
        for room in ("world", "schedule")
        for name in _declared_all(root_dir / "maloc" / room / "__init__.py") or []
    } | {"maloc.detection.rangetest"}
    declared = {}
    for file in _public_modules(root_dir):
        names = _declared_all(file)
        module = _module_name(file, root_dir)
        package = file.name == "__init__.py"
        if names is not None and (package or module.count(".") == 1 or module in handed_on):
            declared[module] = set(names)
    # maloc.readers is reached through maloc.data; the command line has its own page.
    for private in ("maloc.readers", "maloc.cli"):
        declared.pop(private, None)
    assert {m: n for m, n in declared.items() if n} == listed


def test_no_machine_paths_or_leftovers(root_dir: Path):
    """No path of one machine, registry address or unfinished business in a committed file."""
    # Written in two halves so that this file does not find itself.
    halves = ["/wo rk/", "/t mp/", "/ro ot/", "/ho me/", "index- url", "py pi.org", "TO DO"]
    halves += ["FIX ME", "XX X", "NotImplemented Error"]
    banned = re.compile("|".join(re.escape(h.replace(" ", "")) for h in halves))
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=root_dir, capture_output=True, text=True, check=False
    )
    if listing.returncode == 0:
        files = [root_dir / name for name in listing.stdout.split("\0") if name]
    else:
        files = [f for d in ("maloc", "models", "tests", "docs") for f in (root_dir / d).rglob("*")]
    text = {".py", ".md", ".toml", ".txt", ".ipynb", ".cff", ".yml", "", ".cfg", ".csv"}
    found = []
    for file in files:
        if file.suffix in text and file.is_file() and not file.is_symlink():
            for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
                if banned.search(line):
                    found.append(f"{file.relative_to(root_dir)}:{number}: {line.strip()[:80]}")
    assert found == []


def test_constraints_are_exact_versions(root_dir: Path):
    """Only name==version, once a name, and every dependency of ours among them."""
    lines = [
        line
        for line in (root_dir / "constraints.txt").read_text().splitlines()
        if line and not line.startswith("#")
    ]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][0-9A-Za-z.+]*", line) for line in lines)
    names = [re.sub(r"[._-]+", "-", line.split("==")[0]).lower() for line in lines]
    assert len(set(names)) == len(names)
    project = tomllib.loads((root_dir / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"].values()
    wanted = [*project["dependencies"], *(w for extra in extras for w in extra)]
    asked = {re.sub(r"[._-]+", "-", re.split(r"[>=<\[; ]", w)[0]).lower() for w in wanted}
    assert asked - {"maloc"} <= set(names)


def test_readme_states_the_numbers_that_were_measured(root_dir):
    """Its table is the one that benchmarks.readme makes of docs/readme_numbers.csv."""
    from benchmarks import readme

    page = (root_dir / "README.md").read_text()
    stated = page.split(readme.BEGIN)[1].split(readme.END)[0]
    assert stated == readme.table(readme.read_numbers())
    assert "3.32 m" not in page
