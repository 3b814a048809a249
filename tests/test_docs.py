"""The documentation: every command, table and file that it shows exists, and the reference is made from the code."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.util
import inspect
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import yaml
from campaigns import decay

import bayes_damper
from bayes_damper.calibration import Experiment, TrialRecord, default_priors
from bayes_damper.cli import _parser, main
from bayes_damper.effects import EFFECTS, load_effects
from bayes_damper.priors.distributions import Uniform
from bayes_damper.report.terms import _TERMS
from bayes_damper.runs.json_files import read_json
from bayes_damper.validation.withheld import verify
from validation.proofs import page as proof_page

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(p for p in DOCS.rglob("*.md") if "proof" not in p.parts)
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def pages_of(nav: object) -> list[str]:
    if isinstance(nav, str):
        return [nav]
    parts = nav.values() if isinstance(nav, dict) else nav
    return [page for part in parts for page in pages_of(part)]


def settings():
    loader = type("Loader", (yaml.SafeLoader,), {})
    return yaml.load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"), Loader=loader)


def test_every_page_is_in_the_contents_and_every_entry_is_a_page():
    nav = settings()["nav"]
    assert sorted(pages_of(nav)) == sorted(p.relative_to(DOCS).as_posix() for p in DOCS.rglob("*.md"))


def test_pages_that_are_opened_as_files_can_be_searched_without_another_host():
    """The plugin loads a script called iframe-worker from the web unless there is one of that name."""
    assert "offline" in settings()["plugins"]
    (script,) = settings()["extra"]["polyfills"]
    assert "iframe-worker" in script
    assert "window.Worker = " in (DOCS / script).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#:]+?)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).is_file(), f"{page}: {target}"


HOME_MADE = (
    "told", "tells", "speaks for", "speak for", "bears out", "bear out", "vetoes", "impostor", "laid to", "a set each",
    "of which nothing", "hangs on choices", "little by little", "weighs in", "lets go of", "what is left of it",
)  # fmt: skip
"""Words and phrases that readers of the docs stumbled over; ordinary English has others."""


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES, *sorted((DOCS / "proof").glob("[!tw]*.md"))], ids=name_of)
def test_the_pages_keep_to_ordinary_technical_english(page):
    text = " ".join(page.read_text(encoding="utf-8").split())
    found = {phrase for phrase in HOME_MADE if re.search(rf"\b{phrase}\b", text)}
    assert not found, "say shows, reports, gives, supports, imitates: see Style in CONTRIBUTING.md"


def commands_of(page: Path) -> list[list[str]]:
    """Every command of a page: in fenced and in indented blocks, and in the running text."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = [
        *re.findall(r"^ *(?:\$ )?(bayes-damper .*)$", text, re.MULTILINE),
        *re.findall(r"`(bayes-damper [^`]+)`", text),
    ]
    return [shlex.split(line, comments=True) for line in lines]


COMMANDS = [
    (page, words)
    for page in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")), *sorted(ROOT.glob("*/*/README.md")))
    for words in commands_of(page)
]


def refused(words: list[str]) -> bool:
    """Whether the command line does not take these words. A command named without any is only named."""
    try:
        _parser().parse_args([*words[1:], *(["--help"] if len(words) == 2 else [])])
    except SystemExit as stopped:
        return stopped.code != 0
    return False


@pytest.mark.parametrize(("page", "words"), COMMANDS, ids=[" ".join(w[:4]) for _, w in COMMANDS])
def test_commands_on_the_pages_have_these_arguments(page, words, capsys):
    assert not refused(words), f"{page}: {' '.join(words)}\n{capsys.readouterr().err}"


WRONG_COMMANDS = """
    bayes-damper fit my_rig --ot a   # said

```console
$ bayes-damper plan my_rig \\
    --outt b
bayes-damper simulate --rate fast
```

Or `bayes-damper resum FOLDER`, or `bayes-damper tune FOLDER
--case I`, or `bayes-damper fitt`.
"""


def test_a_wrong_command_is_found_wherever_it_stands_on_a_page(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(WRONG_COMMANDS, encoding="utf-8")
    found = {" ".join(words[1:3]): refused(words) for words in commands_of(page)}
    right = found.pop("tune FOLDER")
    assert found == dict.fromkeys(["fit my_rig", "plan my_rig", "simulate --rate", "resum FOLDER", "fitt"], True)
    assert not right


@pytest.mark.parametrize("page", [ROOT / "README.md", *PAGES], ids=name_of)
def test_targets_of_make_on_the_pages_exist(page):
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(re.findall(r"^ *make ([a-z-]+)|`make ([a-z-]+)`", page.read_text(encoding="utf-8"), re.MULTILINE)) <= {
        pair for target in targets for pair in ((target, ""), ("", target))
    }


@pytest.mark.parametrize("page", [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))], ids=name_of)
def test_rows_of_a_table_have_as_many_cells_as_its_head(page):
    """With a ruler of another length than its head a table is shown as text."""
    cells = 0
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        here = len(re.findall(r"(?<!\\)\|", re.sub(r"`[^`]*`", "", line))) if line.startswith("|") else 0
        assert here == cells or not (here and cells), f"{page.name}, line {number}: {here - 1} cells, head {cells - 1}"
        cells = here


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "toml")], ids=name_of)
def test_tables_on_the_pages_are_toml(page):
    for block in blocks(page, "toml"):
        assert tomllib.loads(block)


def test_the_effect_on_its_page_is_a_sound_effect(tmp_path):
    block = blocks(DOCS / "how-to" / "effect.md", "python")[0]
    (tmp_path / "cubic_drag.py").write_text(block, encoding="utf-8")
    effect = load_effects(tmp_path)["cubic_drag"]
    assert "Source:" in block.split('"""')[1], "its first docstring holds `Source:`, as the files of the library do"
    assert len(effect.variants[0].starts) == 2, "it brings a small start of its own, as those of the library do"
    checked = [sys.executable, "-m", "ruff", "check", "--stdin-filename", "bayes_damper/effects/cubic_drag.py", "-"]
    done = subprocess.run(checked, input=block, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, f"moved to bayes_damper/effects it would not pass `make lint`: {done.stdout}"


def test_the_counts_of_effects_in_the_readme_are_those_of_the_library():
    counts = f"{len(EFFECTS)} effects ({sum(len(e.variants) for e in EFFECTS.values())} formulas)"
    assert counts in (ROOT / "README.md").read_text(encoding="utf-8"), f"README.md: write {counts}"


def generator():
    spec = importlib.util.spec_from_file_location("generator_of_docs", DOCS / "_generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_holds_every_command_name_and_effect():
    made = generator()
    commands = made.on_page_markdown("<!-- generated: commands -->")
    choices = next(a.choices for a in _parser()._actions if a.choices and "check" in a.choices)
    assert [f"## {name}\n" in commands for name in choices] == [True] * len(choices)
    names = made.python()
    assert all(f"from bayes_damper import {name}`" in names for name in bayes_damper.__all__)
    effects = made.effects()
    described = {name: f"*{e.title[0].upper() + e.title[1:]}.* {e.summary}" for name, e in EFFECTS.items()}
    left_out = [name for name in EFFECTS if f"### {name}\n\n{described[name]}" not in effects]
    assert not left_out, f"{left_out}: not in the reference, which lists effects by site; is theirs one of SITES?"
    assert "`friction_torque`" in made.parameters()


def test_the_table_of_default_priors_is_that_of_the_code():
    """Of a rig whose inertias, spring and angle are 1, the medians are the numbers of the table."""
    page = (DOCS / "how-to" / "priors.md").read_text(encoding="utf-8")
    times = np.arange(100) / 100.0
    trial = TrialRecord("a", "I", True, 1, times, np.zeros((2, 100)), 0, 1.0, 0.01)
    found = default_priors(Experiment({"J1": (1.0, 0.0), "J2": (1.0, 0.0)}, ((1.0, 0.0),), (trial,)))
    for name, prior in found.items():
        if name == "tail":
            row = re.search(r"^\| `tail` \| ([\d.]+):[^|]*\| flat from (\S+) to (\S+) \|$", page, re.MULTILINE)
            assert prior == Uniform(*(float(x) for x in row.groups()[1:]))
            assert float(row[1]) == prior.ppf(0.5)
        elif name != "c3t":  # told as a multiple of c1t
            number, factor = re.search(rf"^\| `{name}` \| ([\d.]+)[^|]*\| ([\d.]+) \|$", page, re.MULTILINE).groups()
            assert float(number) == pytest.approx(prior.median_value, rel=0.02), name
            assert float(factor) == prior.factor, name


def test_the_tables_of_the_withheld_proof_are_those_of_its_results():
    easy, hard = (read_json(DOCS / "proof" / f"withheld_{kind}.json") for kind in ("easy", "hard"))
    page = (DOCS / "proof" / "withheld.md").read_text(encoding="utf-8")
    assert proof_page.table(easy, hard) in page
    assert proof_page.misses(easy, hard) in page
    assert proof_page.short_table(easy, hard) in page


def test_the_tables_of_drawn_laboratories_are_those_of_their_sealed_verdicts():
    page = (DOCS / "proof" / "laboratories.md").read_text(encoding="utf-8")
    assert proof_page.laboratories(read_json(DOCS / "proof" / "laboratories.json")) in page
    archives = sorted((DOCS / "proof").glob("laboratories_*.zip"))
    assert archives
    assert all(f"({path.name})" in page and verify(path).exit_code == 0 for path in archives)


def test_what_readers_of_the_repository_are_told_does_not_reach_the_pages():
    made = generator()
    marked = [p for p in DOCS.rglob("*.md") if "<!-- generated: " in p.read_text(encoding="utf-8")]
    assert len(marked) == 5
    for page in marked:
        text = page.read_text(encoding="utf-8")
        assert "\n*In the repository this stays empty: `make docs`" in text, page
        assert "In the repository" not in made.on_page_markdown(text), page


def test_thresholds_on_the_page_of_check_are_those_of_the_code(monkeypatch):
    made = generator()
    page = (DOCS / "reference" / "check.md").read_text(encoding="utf-8")
    text = made.on_page_markdown(page)
    assert not re.search(r"[{}]|thresholds|In the repository", text)
    assert "| Many readings are missing | more than 20 % |" in text
    assert "a factor above 1 000 000 |" in text
    assert "outside 1e-6 to 1e6 N" in text
    monkeypatch.setattr("bayes_damper.campaign.plausibility._MISSING", 0.3)
    assert "| Many readings are missing | more than 30 % |" in made.on_page_markdown(page)
    named = re.compile(r"\{[^}]*\}|`[^`]*`|\bk1t|\bJ[12]\b|theta0|\b[01]\b")
    cells = [line.split("|")[2] for line in page.splitlines() if line.startswith("| ")]
    typed = [cell for cell in cells if re.search(r"\d", named.sub("", cell))]
    assert not typed, "name the constant of the code in place of the number, as {plausibility._MISSING:.0%}"


def test_every_public_name_can_be_had_and_is_documented():
    for name in bayes_damper.__all__:
        value = getattr(bayes_damper, name)
        assert callable(value), f"{name} is hidden by its module"
        assert value.__doc__, name
    assert set(bayes_damper.__all__) <= set(dir(bayes_damper))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        bayes_damper.nothing  # noqa: B018


# init, as the pages show it -----------------------------------------------------------------------------------------


def test_logger_files_become_a_campaign_by_options(tmp_path, capsys):
    times = np.arange(-200, 800) / 1000.0
    rng = np.random.default_rng(3)
    for i in range(2):
        y = (decay(times, 0.082, 10.2, 0.031) + rng.standard_normal(times.size)) * 0.1 / 9.80665
        rows = [f"{1e3 * t:.1f};{v:.6f}".replace(".", ",") for t, v in zip(times, y, strict=True)]
        (tmp_path / f"run{i}.csv").write_text("\n".join(["Logger 7", "Time;Ch1", *rows]) + "\n", encoding="utf-8")
    options = (
        "--time Time --time-unit ms --columns Ch1 --units g --mounting-radius 0.1 --decimal , --skip-lines 1 "
        "--release find --primary-inertia 3.015e-3 --case IV --k1t 10.2 --theta0 4.7"
    )
    words = ["init", str(tmp_path / "rig"), "run0.csv", "run1.csv", "--raw", str(tmp_path), *options.split()]
    assert main(words) == 0
    assert "rig: 2 trials, 1 case, acceleration" in capsys.readouterr().out
    assert main(words) == 2
    assert "holds a campaign already" in capsys.readouterr().err
    again = ["init", str(tmp_path / "again"), "--table", str(tmp_path / "rig" / "import.toml")]
    assert main(again) == 0
    first, second = ((tmp_path / n / "trials.csv").read_bytes() for n in ("rig", "again"))
    assert first == second


def test_init_asks_nothing_without_a_terminal(tmp_path, capsys, monkeypatch):
    (tmp_path / "a.csv").write_text("t,a,b,c\n0,1,1,1\n1,2,2,2\n2,3,3,3\n", encoding="utf-8")
    monkeypatch.setattr("builtins.input", lambda _: pytest.fail("asked"))
    assert main(["init", str(tmp_path / "rig"), str(tmp_path / "a.csv"), "--time", "t"]) == 2
    assert "has t, a, b, c; name the channels with --columns" in capsys.readouterr().err


def test_init_asks_in_a_terminal(tmp_path, monkeypatch, capsys):
    times = np.arange(-200, 800) / 1000.0
    y = decay(times, 0.082, 10.2, 0.031) + np.random.default_rng(3).standard_normal(times.size)
    rows = [f"{t:.3f},{v:.5f}" for t, v in zip(times, y, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,a", *rows]) + "\n", encoding="utf-8")
    answers = iter(["", "a", "t", "rad/s^2", "", "3.015e-3", "", "", "", "", "10.2", "4.7"])
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert main(["init", str(tmp_path / "rig"), str(tmp_path / "a.csv"), "--release", "find"]) == 0
    assert "1 trial," in capsys.readouterr().out


# Notebooks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", NOTEBOOKS, ids=name_of)
def test_notebooks_tell_a_story_with_public_calls_only(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert f"({path.name})" in (ROOT / "notebooks" / "README.md").read_text(encoding="utf-8")
    code = ["".join(c["source"]) for c in notebook["cells"] if c["cell_type"] == "code"]
    assert all(not c["outputs"] and c["execution_count"] is None for c in notebook["cells"] if c["cell_type"] == "code")
    tree = ast.parse("\n".join(code))
    kinds = (ast.FunctionDef, ast.ClassDef, ast.AsyncFunctionDef, ast.Lambda)
    assert not [n for n in ast.walk(tree) if isinstance(n, kinds)], (
        "code that is more than calls belongs in the package"
    )
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "bayes_damper":
            assert {a.name for a in node.names} <= set(bayes_damper.__all__)


def test_the_glossary_has_every_word_that_a_report_explains():
    glossary = (DOCS / "glossary.md").read_text(encoding="utf-8")
    entries = " ".join(re.findall(r"^(\S.*)\n:   ", glossary, re.MULTILINE)).lower()
    wanted = {part for term in _TERMS for part in term.word.removesuffix(", as an answer").split(", ")}
    missing = [word for word in wanted if word.lower().rstrip("s") not in entries and f"`{word}`" not in glossary]
    assert not missing


@pytest.mark.parametrize("name", bayes_damper.__all__)
def test_the_reference_explains_every_argument_of_a_public_function(name):
    """By name, in the docstring, unless it is the only one. Methods of a public class as well."""
    value = getattr(bayes_damper, name)
    methods = [f for n, f in vars(value).items() if inspect.isfunction(f) and not n.startswith("_")]
    for function in (value, *(methods if inspect.isclass(value) else ())):
        text = inspect.getdoc(function) or ""
        names = [p for p in inspect.signature(function).parameters if p not in ("self", "options")]
        missing = [p for p in names if not re.search(rf"\b{p}\b", text)]
        where = f"{function.__module__}.{function.__qualname__}"
        assert len(names) == 1 or not missing, f"{where}: explain in its docstring, by name: {', '.join(missing)}"


def test_the_reference_tells_what_a_function_gives():
    text = generator().python()
    for name, told in (("Fit", "`summary`: FitFile"), ("TuneResult", "`target_db`: float"), ("Campaign", "`trials`")):
        assert f"**Gives** `{name}`: " in text
        assert told in text.partition(f"**Gives** `{name}`: ")[2].partition("\n## ")[0]


def test_there_are_at_most_five_notebooks():
    assert 1 <= len(NOTEBOOKS) <= 5


def test_the_campaign_of_the_first_figure_is_shipped_and_its_cause_is_the_one_that_is_told():
    """Campaigns are replaced whole now and then; the figure on the first page has to go with them."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    told = re.search(r"campaign (\w{12}) of `data/withheld`", text)
    assert told
    assert (ROOT / "data" / "withheld" / "campaigns" / told[1] / "campaign.toml").is_file()
    key = json.loads((ROOT / "data" / "withheld" / "campaigns_key.json").read_text(encoding="utf-8"))["campaigns"]
    assert f"before and after {key[told[1]]['truth']} is added" in (DOCS / "how-to" / "verdict.md").read_text("utf-8")


HOMEMADE = re.compile(r"\b(tells?|told|telling)\b|looks are paid|laid to the formula", re.IGNORECASE)


@pytest.mark.parametrize("page", sorted(p for p in DOCS.rglob("*.md") if "proof" not in p.parts), ids=lambda p: p.stem)
def test_pages_use_the_words_of_the_field(page):
    """`cannot tell` is a value of a result file."""
    text = page.read_text(encoding="utf-8").replace("`cannot tell`", "")
    found = [f"line {n}: {line.strip()}" for n, line in enumerate(text.splitlines(), 1) if HOMEMADE.search(line)]
    assert not found, f"{page.name}: say shows, reports, gives, distinguishes: " + "; ".join(found)


def test_the_package_shows_its_public_names_its_version_and_that_it_is_typed():
    assert {name for name in dir(bayes_damper) if not name.startswith("__")} == set(bayes_damper.__all__)
    assert bayes_damper.__version__ == importlib.metadata.version("bayes-damper")
    assert (Path(bayes_damper.__file__).parent / "py.typed").is_file()


def test_the_gallery_shows_the_pictures_that_its_script_draws_with_the_commands_that_it_runs():
    spec = importlib.util.spec_from_file_location("gallery", ROOT / "tools" / "gallery.py")
    gallery = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(gallery)
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert re.findall(r"\(gallery/(\w+)\.png\)", page) == list(gallery.PICTURES)
    assert set(re.findall(r"^    bayes-damper (.*)$", page, re.MULTILINE)) == set(gallery.COMMANDS)
    sizes = {name: (DOCS / "gallery" / f"{name}.png").stat().st_size for name in gallery.PICTURES}
    assert max(sizes.values()) < 80_000, "small enough for a page on a phone"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_sentences_of_a_page_are_short(page):
    """On average at most 25 words: what a reading grade of 10 asks for (`tools/readability.py` gives the grade)."""
    spec = importlib.util.spec_from_file_location("readability", ROOT / "tools" / "readability.py")
    readability = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(readability)
    text = readability.prose(page.read_text(encoding="utf-8"))
    lengths = [len(s.split()) for s in re.split(r"[.!?:;](?:\s|$)", text) if s.split()]
    assert sum(lengths) / max(len(lengths), 1) <= 25.0
