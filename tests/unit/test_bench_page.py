"""The README's figures are those of the last benchmark."""

from tests import bench_page


def test_the_readme_shows_the_kept_figures() -> None:
    """A change by hand between the marks is found."""
    text = bench_page.README.read_text(encoding="utf-8")
    assert bench_page.with_figures(text, bench_page.kept()) == text


def test_parts_are_measured_one_at_a_time() -> None:
    parts = {
        "logs": {"measured": "today, 2 cores", "rows": [["replay", "9 x", "10 x"], ["x", "1", ""]]},
        "latency": {"measured": "earlier", "rows": [["p50", "0.2 ms", "0.3 ms"]]},
    }
    text = f"before\n{bench_page.BEGIN}old\n{bench_page.END}after\n"
    assert bench_page.with_figures(text, parts) == (
        f"before\n{bench_page.BEGIN}"
        "| figure | measured | aim |\n|---|---|---|\n"
        "| replay | 9 x | 10 x |\n| p50 | 0.2 ms | 0.3 ms |\n"
        "\nMeasured: `logs`: today, 2 cores; `latency`: earlier.\n"
        f"{bench_page.END}after\n"
    )
