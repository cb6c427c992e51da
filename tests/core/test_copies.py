"""Objects are copied and sent to other processes as they are: metadata and history included."""

import copy
import pickle

import numpy as np
import pytest

import metrosep as ms
from metrosep.core.provenance import Step

X = np.linspace(0.0, 1e-3, 5)
STEP = Step("read", {"file": "a.csv", "n": 5})


@pytest.mark.parametrize(
    "obj",
    [
        STEP,
        ms.Profile(X, X**2, metadata={"unit": "m"}, history=(STEP,)),
        ms.Surface(np.eye(3), 1e-6, 2e-6, metadata={"k": (1, 2)}, history=(STEP,)),
        ms.Recording(X, {"gap": X}, units={"gap": "m"}, history=(STEP,)),
        ms.RunSet([ms.Run(X, X, feed=0.1, run_id="r")], history=(STEP,)),
    ],
    ids=lambda obj: type(obj).__name__,
)
@pytest.mark.parametrize("again", [copy.deepcopy, lambda obj: pickle.loads(pickle.dumps(obj))])  # noqa: S301
def test_copies_say_the_same(obj, again):
    other = again(obj)

    assert type(other) is type(obj)
    assert repr(other) == repr(obj)
    if isinstance(obj, Step):
        assert other == obj
    else:
        assert other.history == obj.history
        assert dict(other.metadata) == dict(obj.metadata)
        with pytest.raises(TypeError):
            other.metadata["new"] = 1
