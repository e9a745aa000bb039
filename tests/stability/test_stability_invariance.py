"""Moving the world, units, order of rows and vertices, processes, threads."""

from cases import invariance as stability_cases_invariance

CASES = stability_cases_invariance.CASES


def test_holds(case):
    case.run()
