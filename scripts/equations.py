"""Write docs/equations.md: the function that implements each equation of the papers.

A docstring that implements an equation carries its tag: the paper, then the place in it, in square
brackets, as in ``[M07 §3]``, ``[M09 (22)]``, ``[D14 Alg. 2]``. The paper alone stands for all of
it; ``[M07 §3; S05]`` is two tags. ``[PMB (3)]`` is equation 3 of docs/methods.md, Poisson
multi-Bernoulli, ``[APP (2)]`` one of Appearance there. The script reads the docstrings under
src/phdtrack without importing anything and lists the tags by paper. ``--check`` writes nothing and
fails if the page is out of date.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "src" / "phdtrack"
PAGE = ROOT / "docs" / "equations.md"

PAPERS = {
    "M07": (
        "Maggio, Piccardo, Regazzoni, Cavallaro: Particle PHD filtering for multi-target visual"
        " tracking. ICASSP 2007"
    ),
    "M09": (
        "Maggio, Cavallaro: Learning scene context for multiple object tracking. IEEE Trans. Image"
        " Processing, 2009"
    ),
    "E13": (
        "Edman, Andersson, Jamrog, Gustafsson: Pedestrian group tracking using the GM-PHD filter."
        " EUSIPCO 2013"
    ),
    "D14": (
        "Daniyan: Performance analysis of sequential Monte Carlo MCMC and PHD filters on"
        " multi-target tracking in video"
    ),
    "S05": (
        "Shafique, Shah: A noniterative greedy algorithm for multiframe point correspondence. IEEE"
        " Trans. PAMI, 2005"
    ),
    "V06": (
        "Vo, Ma: The Gaussian mixture probability hypothesis density filter. IEEE Trans. Signal"
        " Processing, 2006"
    ),
    "V05": (
        "Vo, Singh, Doucet: Sequential Monte Carlo methods for multi-target filtering with random"
        " finite sets. 2005"
    ),
    "V07": (
        "Vo, Vo, Cantoni: Analytic implementations of the cardinalized PHD filter. IEEE Trans."
        " Signal Processing, 2007"
    ),
    "K05": (
        "Khan, Balch, Dellaert: MCMC-based particle filtering for tracking interacting targets."
        " IEEE Trans. PAMI, 2005"
    ),
    "G93": (
        "Gordon, Salmond, Smith: Novel approach to nonlinear/non-Gaussian Bayesian state"
        " estimation. IEE Proc. F, 1993"
    ),
    "R65": (
        "Rauch, Tung, Striebel: Maximum likelihood estimates of linear dynamic systems. AIAA"
        " Journal, 1965"
    ),
    "R79": "Reid: An algorithm for tracking multiple targets. IEEE Trans. Automatic Control, 1979",
    "C96": (
        "Cox, Hingorani: An efficient implementation of Reid's multiple hypothesis tracking"
        " algorithm. IEEE PAMI, 1996"
    ),
    "W15": (
        "Williams: Marginal multi-Bernoulli filters: RFS derivation of MHT, JIPDA, and"
        " association-based MeMBer. IEEE Trans. AES, 2015"
    ),
    "PMB": "The default filter: docs/methods.md, Poisson multi-Bernoulli, whose numbers these are",
    "APP": "What boxes look like: docs/methods.md, Appearance, whose numbers these are",
    "G18": (
        "García-Fernández, Williams, Granström, Svensson: Poisson multi-Bernoulli mixture filter:"
        " direct derivation and implementation. IEEE Trans. AES, 2018"
    ),
    "T20": (
        "García-Fernández, Svensson, Williams, Xia, Granström: Trajectory Poisson multi-Bernoulli"
        " filters. 2020"
    ),
    "W14": (
        "Williams, Lau: Approximate evaluation of marginal association probabilities with belief"
        " propagation. IEEE Trans. AES, 2014"
    ),
    "C04": (
        "Cavallaro, Ebrahimi: Interaction between high-level and low-level image analysis for video"
        " objects. 2004"
    ),
    "Z04": (
        "Zivkovic, van der Heijden: Recursive unsupervised learning of finite mixture models. IEEE"
        " Trans. PAMI, 2004"
    ),
    "S78": "Schwarz: Estimating the dimension of a model. Annals of Statistics, 1978",
    "B94": (
        "Bedrick, Tsai: Model selection for multivariate regression in small samples. Biometrics,"
        " 1994"
    ),
    "G13": (
        "Gelman, Carlin, Stern, Dunson, Vehtari, Rubin: Bayesian data analysis, third edition. 2013"
    ),
    "B08": (
        "Bernardin, Stiefelhagen: Evaluating multiple object tracking performance: the CLEAR MOT"
        " metrics. 2008"
    ),
    "L20": (
        "Luiten et al.: HOTA: a higher order metric for evaluating multi-object tracking. IJCV,"
        " 2020"
    ),
    "R16": (
        "Ristani et al.: Performance measures and a data set for multi-target, multi-camera"
        " tracking. ECCV, 2016"
    ),
    "S08": (
        "Schuhmacher, Vo, Vo: A consistent metric for performance evaluation of multi-object"
        " filters. IEEE TSP, 2008"
    ),
    "K09": (
        "Kasturi et al.: Framework for performance evaluation of face, text, and vehicle detection."
        " PAMI 2009"
    ),
    "B17": (
        "Beard, Vo, Vo: OSPA(2): Using the OSPA metric to evaluate multi-target tracking"
        " performance. ICCAIS 2017"
    ),
    "B20": (
        "Beard, Vo, Vo: A solution for large-scale multi-object tracking. IEEE Trans. Signal"
        " Processing, 2020"
    ),
    "G20": (
        "García-Fernández, Rahmathullah, Svensson: A metric on the space of finite sets of"
        " trajectories. IEEE TSP, 2020"
    ),
    "G17": (
        "Rahmathullah, García-Fernández, Svensson: Generalized optimal sub-pattern assignment"
        " metric. FUSION 2017"
    ),
    "WH97": (
        "West, Harrison: Bayesian forecasting and dynamic models, second edition. Springer, 1997"
    ),
    "B01": (
        "Bar-Shalom, Li, Kirubarajan: Estimation with applications to tracking and navigation."
        " Wiley, 2001"
    ),
}
Documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
PAPER = r"(?:[A-Z]{1,2}\d{2}|PMB|APP)"
BRACKET = re.compile(rf"\[({PAPER}(?![\w])[^\[\]]*)\](?!\()")
BETWEEN = re.compile(rf"[;,]\s*(?={PAPER}\b)")
PART = re.compile(rf"({PAPER})(?: (.+))?")

HEAD = """# Equations and where they are

Generated by `make docs` from the tags in the docstrings under `src/phdtrack`; do not edit.
[Methods](methods.md) has the main equations themselves, [notation](notation.md) the symbols. A dash
stands for a paper as a whole. The default filter's equations have numbers of their own, those of
[methods](methods.md#poisson-multi-bernoulli), under the tag PMB.
"""


@dataclass(frozen=True, slots=True)
class Entry:
    """One tag: paper, place in it, and the function that carries it, with file and line."""

    paper: str
    place: str
    owner: str
    path: Path
    line: int
    summary: str


def docstrings(tree: ast.Module, module: str) -> Iterator[tuple[str, int, str]]:
    """Yield name, line and docstring of each documented definition, the module first."""

    def walk(node: Documented, name: str) -> Iterator[tuple[str, int, str]]:
        text = ast.get_docstring(node)
        if text:
            yield name, 1 if isinstance(node, ast.Module) else node.lineno, text
        for child in node.body:
            if isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                yield from walk(child, f"{name}.{child.name}")

    return walk(tree, module)


def tags(text: str) -> Iterator[tuple[str, str]]:
    """Yield paper and place of each tag in a docstring.

    A semicolon or comma separates several tags in one pair of brackets.
    """
    for inside in BRACKET.findall(" ".join(text.split())):
        for part in BETWEEN.split(inside):
            if match := PART.fullmatch(part.strip()):
                yield match[1], (match[2] or "").strip()


def summary(text: str) -> str:
    """Return the first paragraph of a docstring for a table cell: one line without tags."""
    first = " ".join(text.split("\n\n")[0].split())
    untagged = " ".join(BRACKET.sub("", first).split())
    return re.sub(r"\s+([.,;:])", r"\1", untagged).replace("|", "\\|")


def entries(sources: Path) -> Iterator[Entry]:
    """Yield every tag under ``sources`` in the order of files and lines, once a docstring."""
    for path in sorted(sources.rglob("*.py")):
        parts = path.relative_to(sources.parent).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        for owner, line, text in docstrings(ast.parse(path.read_text(encoding="utf-8")), module):
            for paper, place in dict.fromkeys(tags(text)):
                yield Entry(paper, place, owner, path, line, summary(text))


def place_key(place: str) -> tuple[tuple[int, int, str], ...]:
    """Return a key that sorts as a reader would: the whole paper, then "(9)" before "(11)"."""
    parts = re.findall(r"\d+|\D+", place)
    return tuple((1, int(p), "") if p.isdigit() else (0, 0, p) for p in parts)


def table(rows: Iterable[Entry], root: Path, page: Path) -> Iterator[str]:
    """Yield the lines of one paper's table."""
    up = "../" * len(page.parent.relative_to(root).parts)
    yield "| place | where | what |"
    yield "|---|---|---|"
    for row in sorted(rows, key=lambda e: (place_key(e.place), e.owner)):
        name = row.owner.removeprefix("phdtrack.")
        link = f"[`{name}`]({up}{row.path.relative_to(root).as_posix()})"
        yield f"| {row.place or '–'} | {link} | {row.summary} |"


def page_text(found: list[Entry], root: Path = ROOT, page: Path = PAGE) -> str:
    """Return the whole page."""
    lines = [HEAD]
    for paper in dict.fromkeys([*PAPERS, *sorted({e.paper for e in found})]):
        rows = [e for e in found if e.paper == paper]
        if rows:
            lines += [f"## {paper}", "", PAPERS[paper] + ".", "", *table(rows, root, page), ""]
    return "\n".join(lines).rstrip("\n") + "\n"


def unknown(found: list[Entry]) -> list[str]:
    """Return an error message for each tag of an unknown paper."""
    return [
        f"{e.path.relative_to(ROOT)}, {e.owner}: no paper has the tag {e.paper}; add it to PAPERS"
        " in scripts/equations.py"
        for e in found
        if e.paper not in PAPERS
    ]


def main(arguments: list[str]) -> int:
    """Write the page, or compare it with ``--check``; return the exit status."""
    found = list(entries(SOURCES))
    if problems := unknown(found):
        print("\n".join(problems), file=sys.stderr)
        return 1
    text = page_text(found)
    if "--check" not in arguments:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    if PAGE.exists() and PAGE.read_text(encoding="utf-8") == text:
        return 0
    print(
        "docs/equations.md is out of date: run `make docs` and commit the page",
        file=sys.stderr,
    )
    return 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
