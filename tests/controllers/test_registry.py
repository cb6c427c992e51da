"""A controller is one module of the package; the registry finds it there."""

import pytest

from metrosep import controllers
from metrosep.controllers import registry

DUMMY = '''
from metrosep.controllers.base import Dialect, DialectInfo, Encoded
from metrosep.controllers.neutral import Neutral


class Dummy(Neutral):
    """A neutral table under another name."""

    info = DialectInfo(
        id="dummy",
        title="Planted",
        entry="correction",
        units="mm",
        max_points=None,
        outside="constant",
        sign_status="by definition",
    )
'''


@pytest.fixture
def planted(tmp_path, monkeypatch):
    (tmp_path / "zz_dummy.py").write_text(DUMMY)
    monkeypatch.setattr(controllers, "__path__", [*controllers.__path__, str(tmp_path)])
    registry._places.cache_clear()
    yield
    registry._places.cache_clear()
    registry.find.cache_clear()


def test_a_planted_controller_is_found(planted):
    assert controllers.names()[-1] == "dummy"
    assert controllers.find("dummy").info.title == "Planted"
    assert [d.id for d in controllers.describe()] == list(controllers.names())


def test_two_controllers_of_one_name_are_refused(planted, tmp_path):
    (tmp_path / "zz_other.py").write_text(DUMMY)

    with pytest.raises(RuntimeError, match="two classes are the controller 'dummy'"):
        controllers.names()
