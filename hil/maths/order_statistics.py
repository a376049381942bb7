"""Order statistics: how many cases show that a probability is met, and with how many allowed failures.

J. M. Hanson and B. B. Beard, Applying Monte Carlo Simulation to Launch Vehicle Design and Requirements Analysis, NASA
TP-2010-216447. ``probability`` is the required fraction of successes; ``risk``, the consumer's, the probability of
accepting a design that just fails to have it. The cases are independent.
"""

from __future__ import annotations

from scipy.special import bdtr

_MOST_CASES = 1 << 40


def acceptance_risk(cases: int, failures: int, probability: float) -> float:
    """Return the consumer's risk of accepting ``failures`` or fewer in ``cases``."""
    return float(bdtr(failures, cases, 1.0 - probability))


def allowed_failures(cases: int, probability: float, risk: float) -> int:
    """Return the largest number of failures that is accepted in ``cases``; -1 if the cases are too few."""
    allowed, refused = -1, cases
    while refused - allowed > 1:
        middle = (allowed + refused) // 2
        if acceptance_risk(cases, middle, probability) <= risk:
            allowed = middle
        else:
            refused = middle
    return allowed


def cases_needed(failures: int, probability: float, risk: float) -> int:
    """Return the least number of cases of which ``failures`` may fail."""
    too_few, enough = failures, failures + 1
    while acceptance_risk(enough, failures, probability) > risk and enough < _MOST_CASES:
        too_few, enough = enough, 2 * enough
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        if acceptance_risk(middle, failures, probability) <= risk:
            enough = middle
        else:
            too_few = middle
    return enough
