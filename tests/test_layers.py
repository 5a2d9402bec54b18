"""How the modules import each other: whatever a contract on layers leaves open within a package."""

from graphlib import CycleError, TopologicalSorter

import grimp


def test_no_modules_import_each_other_in_a_circle():
    # also within functions, and for types alone
    seen = grimp.build_graph("aerobalance", cache_dir=None)
    graph = {name: seen.find_modules_directly_imported_by(name) for name in seen.modules}
    assert "aerobalance.recording.errors" in graph["aerobalance.recording.recording"]  # so that imports are seen
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as problem:
        raise AssertionError(" -> ".join(problem.args[1])) from None
