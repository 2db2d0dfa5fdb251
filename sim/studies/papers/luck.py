"""The same page with other seed roots: `Page.lucky` says which verdicts they change."""

from collections.abc import Sequence

from sim.studies.page import SEED_ROOT
from sim.studies.papers import Paper, Progress
from sim.studies.papers.page import Page


def draw_again(paper: Paper, page: Page, roots: Sequence[int], progress: Progress) -> None:
    """Reproduce `paper` with each of `roots`, without files, and keep the results as `page.others`.

    Raises `ValueError` for the root of the page itself: it would only repeat the page.
    """
    if page.root in roots:
        raise ValueError(f"seed root {page.root} is that of the page itself: check another one")
    for done, root in enumerate(dict.fromkeys(roots)):
        token = SEED_ROOT.set(root)
        try:

            def report(share: float, what: str, done: int = done, root: int = root) -> None:
                progress((done + share) / len(roots), f"root {root}: {what}")

            page.others.append(paper.reproduce(page.seeds, None, report))
        finally:
            SEED_ROOT.reset(token)
