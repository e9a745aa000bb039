"""A test with an argument `case` runs once for every case of its module's CASES; slow ones are marked."""

import pytest


def pytest_generate_tests(metafunc):
    if "case" in metafunc.fixturenames:
        marks = {True: [pytest.mark.slow], False: []}
        cases = [pytest.param(case, id=str(case), marks=marks[case.slow]) for case in metafunc.module.CASES.found]
        metafunc.parametrize("case", cases)
