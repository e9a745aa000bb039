"""NaN, infinity, denormals, nothing, one row, a million, single precision, at every door."""

from fusion.benchmarks import stability_cases_values

CASES = stability_cases_values.CASES


def test_holds(case):
    case.run()
