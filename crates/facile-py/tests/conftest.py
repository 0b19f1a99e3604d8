"""What tests share."""

import importlib
import os

import pytest

#: Set where everything that tests need must be there, as in the gate: what is missing then fails instead of being skipped.
ALL = bool(os.environ.get("FACILE_ALL_TESTS"))


@pytest.fixture(scope="session")
def needed():
    """Imports a module, or gives what `find` finds; skips the test where that is missing, except in the gate."""

    def need(name, find=importlib.import_module):
        try:
            found = find(name)
        except ImportError:
            found = None
        if found is None:
            message = f"skipped: {name} is not installed"
            pytest.fail(message) if ALL else pytest.skip(message)
        return found

    return need
