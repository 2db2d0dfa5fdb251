"""The genetic search of paper K, section III: strings of 15 bits for three gains.

A string holds 5 bits for each gain, on [0, 3], [0, 1] and [0, 1]. A generation takes pairs by
tournament, makes two children of each by one-point crossover (probability .9) and two more by
flipping bits with the probability (8), and the best of old and new remain; the best string and its
nearest (9) always do. Sixteen strings of 15 bits are the 240 of (8).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Gains = tuple[float, float, float]
Selection = Callable[[list[int], Callable[[int], float], np.random.Generator], int]
"""(population, cost, random numbers) -> a parent."""

BITS = 5
RANGES = ((0.0, 3.0), (0.0, 1.0), (0.0, 1.0))
STRING_BITS = BITS * len(RANGES)
POPULATION = 16
TOURNAMENT = 3
CROSSOVER = 0.9
GENERATIONS = 60
PAPER_GAINS = (3.0, 20.0 / 31.0, 27.0 / 31.0)


def mutation_probability(generation: int) -> float:
    """p_m of (8)."""
    return 1.0 / 240.0 + 0.11375 / 2.0**generation


def decode(string: int) -> Gains:
    """Gains of a string of 15 bits, K1 in the highest five."""
    shares = [((string >> (BITS * place)) & (2**BITS - 1)) / (2**BITS - 1) for place in (2, 1, 0)]
    K1, K2, K3 = (
        low + share * (high - low) for share, (low, high) in zip(shares, RANGES, strict=True)
    )
    return K1, K2, K3


def encode(gains: Gains) -> int:
    """The string whose gains are nearest."""
    string = 0
    for gain, (low, high) in zip(gains, RANGES, strict=True):
        string = (string << BITS) | round((gain - low) / (high - low) * (2**BITS - 1))
    return string


@dataclass(frozen=True)
class Search:
    """What a genetic search found."""

    string: int
    cost: float
    history: tuple[float, ...]
    """lowest cost of each generation"""
    evaluations: int
    """different strings tried"""


def search(
    cost: Callable[[int], float],
    random: np.random.Generator,
    generations: int = GENERATIONS,
    on_progress: Callable[[float], None] | None = None,
    selection: Selection | None = None,
) -> Search:
    """The paper's steps 1-5: the string with the lowest cost that was found; parents by tournament
    unless another `selection` is given."""
    select = selection or tournament
    known: dict[int, float] = {}

    def price(string: int) -> float:
        if string not in known:
            known[string] = cost(string)
        return known[string]

    population = [int(string) for string in random.integers(0, 2**STRING_BITS, POPULATION)]
    history = [min(price(string) for string in population)]
    for generation in range(generations):
        children: list[int] = []
        for _ in range(POPULATION // 2):
            pair = select(population, price, random), select(population, price, random)
            children += _crossover(*pair, random)
            children += [
                _mutate(parent, mutation_probability(generation), random) for parent in pair
            ]
        population = _dominant(population + children, price)
        history.append(price(population[0]))
        if on_progress is not None:
            on_progress((generation + 1) / generations)
    best = min(population, key=price)
    return Search(best, price(best), tuple(history), len(known))


def tournament(
    population: list[int], price: Callable[[int], float], random: np.random.Generator
) -> int:
    """The best of a few strings drawn with equal probability."""
    chosen = random.integers(0, len(population), TOURNAMENT)
    return min((population[int(index)] for index in chosen), key=price)


def roulette(
    population: list[int], price: Callable[[int], float], random: np.random.Generator
) -> int:
    """A string with a probability in proportion to 1 / cost, the paper's selection."""
    fitness = np.array([1.0 / price(string) for string in population])
    if not fitness.sum() > 0.0:
        return population[int(random.integers(len(population)))]
    return population[int(random.choice(len(population), p=fitness / fitness.sum()))]


def _crossover(first: int, second: int, random: np.random.Generator) -> list[int]:
    """Two children with their tails exchanged at one point, or copies."""
    if random.random() >= CROSSOVER:
        return [first, second]
    tail = (1 << int(random.integers(1, STRING_BITS))) - 1
    return [(first & ~tail) | (second & tail), (second & ~tail) | (first & tail)]


def _mutate(string: int, probability: float, random: np.random.Generator) -> int:
    flips = random.random(STRING_BITS) < probability
    return string ^ sum(1 << place for place in np.flatnonzero(flips).tolist())


def _dominant(strings: list[int], price: Callable[[int], float]) -> list[int]:
    """The best different strings, the best of all first, then the one nearest to it by (9)."""
    ranked = sorted(set(strings), key=lambda string: (price(string), string))
    best = ranked[0]
    nearest = min(ranked[1:], key=lambda string: (distance(string, best), string), default=best)
    kept = [best, nearest] + [string for string in ranked[1:] if string != nearest]
    return (kept * POPULATION)[:POPULATION]


def distance(first: int, second: int) -> float:
    """(9): squared distance of the gains of two strings."""
    return sum((a - b) ** 2 for a, b in zip(decode(first), decode(second), strict=True))
