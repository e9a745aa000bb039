"""Hessians to condition 1e16, weights over 12 decades, noise of nothing and of everything."""

from cases import numbers as stability_cases_numbers

CASES = stability_cases_numbers.CASES


def test_holds(case):
    case.run()
