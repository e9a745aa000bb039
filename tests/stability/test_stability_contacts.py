"""Contacts on edges, corners and the medial axis, deep inside, in one line, plane or place."""

from fusion.benchmarks import stability_cases_contacts

CASES = stability_cases_contacts.CASES


def test_holds(case):
    case.run()
