"""Lines that are compared can be told apart, also by readers who confuse red and green."""

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from companion.estimators import ESTIMATORS
from companion.plots import style
from tests.paths import ROOT

Array = NDArray[np.float64]
SIGHTS = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
"""Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of color vision
deficiency", IEEE TVCG 15 (2009), severity 1, on linear RGB"""
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def linear(colour: str) -> Array:
    code = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def lab(rgb: Array) -> Array:
    """CIE L*a*b* of linear sRGB, white D65."""
    ratio = TO_XYZ @ rgb / TO_XYZ.sum(axis=1)
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def ciede2000(one: Array, other: Array) -> float:
    """CIE 142-2001, in the notation of Sharma, Wu and Dalal (2005)."""
    chroma = (np.hypot(*one[1:]) + np.hypot(*other[1:])) / 2
    g = 0.5 * (1 - np.sqrt(chroma**7 / (chroma**7 + 25.0**7)))
    a1, a2 = one[1] * (1 + g), other[1] * (1 + g)
    c1, c2 = np.hypot(a1, one[2]), np.hypot(a2, other[2])
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, one[2]), (a2, other[2])))
    turn = (h2 - h1 + 180) % 360 - 180 if c1 * c2 > 0 else 0.0
    d_hue = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2))
    light, c = (one[0] + other[0]) / 2, (c1 + c2) / 2
    hue = (h1 + turn / 2) % 360 if c1 * c2 > 0 else h1 + h2
    t = (
        1
        - 0.17 * np.cos(np.radians(hue - 30))
        + 0.24 * np.cos(np.radians(2 * hue))
        + 0.32 * np.cos(np.radians(3 * hue + 6))
        - 0.20 * np.cos(np.radians(4 * hue - 63))
    )
    s_l = 1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2)
    s_c, s_h = 1 + 0.045 * c, 1 + 0.015 * c * t
    rotation = -2 * np.sqrt(c**7 / (c**7 + 25.0**7))
    rotation *= np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2))))
    d_l, d_c, d_h = (other[0] - one[0]) / s_l, (c2 - c1) / s_c, d_hue / s_h
    return float(np.sqrt(d_l**2 + d_c**2 + d_h**2 + rotation * d_c * d_h))


def difference(one: str, other: str) -> float:
    """The smallest over all sights."""
    seen = (
        [lab(np.clip(sight @ linear(each), 0.0, 1.0)) for each in (one, other)]
        for sight in SIGHTS.values()
    )
    return min(ciede2000(*pair) for pair in seen)


def contrast(colour: str) -> float:
    """With white, as WCAG defines it."""
    return float(1.05 / (TO_XYZ[1] @ linear(colour) + 0.05))


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ],
)
def test_the_difference_is_that_of_sharma(
    one: tuple[float, ...], other: tuple[float, ...], expected: float
) -> None:
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(expected, abs=1e-4)


PLACES = [
    path
    for program in ("companion", "sim")
    for path in sorted((ROOT / program).rglob("*.py"))
    if path.parent != ROOT / "companion" / "plots"
]


@pytest.mark.parametrize("path", PLACES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_no_other_module_has_colours(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert not re.findall(r"""["'](?:#[0-9a-fA-F]{6}|tab:\w+|C\d)["']|colou?r="(?!none)""", text)


def test_the_old_demonstration_would_have_failed() -> None:
    assert difference("#1f77b4", "#9467bd") < 8.0  # Kollsman and autopilot until November 2026


def test_roles_differ_for_every_sight() -> None:
    found = {pair: difference(*pair) for pair in combinations(style.ROLES, 2)}
    assert min(found.values()) >= style.LEAST_DIFFERENCE, found


def test_estimators_differ_for_every_sight() -> None:
    colours = [style.estimator_style(name).colour for name in ESTIMATORS] + [style.TRUTH]
    found = {pair: difference(*pair) for pair in combinations(colours, 2)}
    assert min(found.values()) >= style.LEAST_DIFFERENCE, found


def test_ours_is_above_and_thickest_and_raw_gnss_is_thin_and_below() -> None:
    lines = style.SOURCES
    assert lines["estimate"].width == max(line.width for line in lines.values())
    assert lines["estimate"].order == max(line.order for line in lines.values())
    assert lines["gnss"].width == min(line.width for line in lines.values())
    assert lines["gnss"].order == min(line.order for line in lines.values())


def test_a_label_finds_its_line() -> None:
    assert style.style_of("raw GNSS") is style.SOURCES["gnss"]
    assert style.style_of("vertical-bank").colour == style.FUSED
    with pytest.raises(KeyError):
        style.style_of("nobody")


@pytest.mark.parametrize("colour", [style.INK, style.FAINT, style.GOOD, style.WARNING, style.BAD])
def test_text_can_be_read_on_white(colour: str) -> None:
    assert contrast(colour) >= 4.5
