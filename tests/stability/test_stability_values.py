"""NaN, infinity, denormals, nothing, one row, a million, single precision, at every door."""

from cases import values as stability_cases_values

CASES = stability_cases_values.CASES


def test_holds(case):
    case.run()
