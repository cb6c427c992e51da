"""Options that are yes or no: a text such as "no" is true in Python and must not pass for one."""

import numpy as np
import pytest

from metrosep import Profile, Surface
from metrosep.core.errors import DataError
from metrosep.parameters.budget_lines import repeatability_line
from metrosep.parameters.deviation import form_deviation, roundness_deviation
from metrosep.parameters.noise import NoiseFromRepeats, WhiteNoise, noise_of_repeats
from metrosep.parameters.profile import profile_parameters
from metrosep.parameters.propagation import monte_carlo
from metrosep.parameters.repeats import from_repeats, noise_free_rms, type_a
from metrosep.parameters.softgauge import verify_softgauge
from metrosep.parameters.straightness import straightness_deviation
from metrosep.parameters.uncertainty import noise_influence

X = np.arange(400) * 1e-6
PROFILE = Profile(X, 1e-6 + 1e-7 * np.cos(X * 1e5))
PAIR = (PROFILE, Profile(X, 1e-6 + 1e-7 * np.sin(X * 1e5)))
ROUND = Profile(np.arange(36) * np.pi / 18, 1e-6 * np.cos(np.arange(36) * np.pi / 9) + 1e-2)
NOISE = WhiteNoise(1e-9)
CALLS = {
    "profile centre": lambda v: profile_parameters(PROFILE, kind="R", centre=v),
    "softgauge centre": lambda v: verify_softgauge(PROFILE, centre=v),
    "monte carlo centre": lambda v: monte_carlo("Rq", PROFILE, noise=NOISE, draws=200, centre=v),
    "adaptive": lambda v: monte_carlo("Rq", PROFILE, noise=NOISE, draws=200, adaptive=v),
    "influence centre": lambda v: noise_influence("Rq", PROFILE, NOISE, centre=v),
    "repeats centre": lambda v: from_repeats(PAIR, "Rq", centre=v),
    "rms centre": lambda v: noise_free_rms(PAIR, centre=v),
    "remove_mean": lambda v: noise_of_repeats(PAIR, remove_mean=v),
    "noise remove_mean": lambda v: NoiseFromRepeats(PAIR, remove_mean=v),
    "of_mean": lambda v: repeatability_line(type_a([1.0, 2.0, 4.0]), of_mean=v),
    "normal": lambda v: straightness_deviation(PROFILE, normal=v),
    "exact": lambda v: roundness_deviation(ROUND, exact=v),
    "form normal": lambda v: form_deviation(PROFILE, kind="straightness", normal=v),
    "form exact": lambda v: form_deviation(ROUND, kind="roundness", exact=v),
    "foreign exact": lambda v: form_deviation(
        Surface(np.eye(4), 1e-6, 1e-6), kind="flatness", exact=v
    ),
}


@pytest.mark.parametrize("value", ["no", "false", "", "yes", 0, 1, 1.0, [], np.array([True])])
@pytest.mark.parametrize("call", CALLS)
def test_only_a_bool_is_yes_or_no(call, value):
    name = call.split()[-1]
    with pytest.raises(DataError, match=rf"^{name} is True(, False or None| or False), got "):
        CALLS[call](value)


@pytest.mark.parametrize("call", sorted(set(CALLS) - {"softgauge centre", "adaptive"}))
def test_bools_of_numpy_are_bools(call):
    CALLS[call](np.False_)


def test_no_centring_is_no_centring():
    plain = profile_parameters(PROFILE, kind="R", names=["Ra"])
    off = profile_parameters(PROFILE, kind="R", names=["Ra"], centre=np.False_)
    on = profile_parameters(PROFILE, kind="R", names=["Ra"], centre=np.True_)
    assert off["Ra"].value == plain["Ra"].value
    assert on["Ra"].value < 0.2 * plain["Ra"].value
    assert off.context.settings["centre"] is False
