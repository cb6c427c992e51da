"""Dual servo: the paper's parabola, covariance between runs, static ratio, sums, before/after."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from metrosep.core.errors import (
    DataError,
    DegenerateFitError,
    InvalidSamplesError,
    LimitError,
    TooFewSamplesError,
)
from metrosep.core.profile import Profile
from metrosep.process.dual_servo import before_after, cumulative_error
from metrosep.process.static_errors import compare_static
from metrosep.process.straightness_runs import run_polynomial, straightness_lines

UM, NM, MM = 1e-6, 1e-9, 1e-3
X = np.linspace(0.0, 40.0, 401) * MM
TRUTH = np.array([0.3389 * UM, 0.48246 * UM / MM, -0.00605 * UM / MM**2])
"""Eq. 1 of the paper in SI, signs (+, -)."""


def y(x):
    return TRUTH[0] + TRUTH[1] * x + TRUTH[2] * x**2


def simulated_runs(rng, n=5):
    """papers.md section 2: 20 nm noise, drift of 50 nm and 30 nm/40 mm per run."""
    return [
        Profile(
            X,
            y(X)
            + 20 * NM * rng.standard_normal(X.size)
            + 50 * NM * rng.standard_normal()
            + 30 * NM / (40 * MM) * (X - 20 * MM) * rng.standard_normal(),
        )
        for _ in range(n)
    ]


class TestStraightness:
    def test_row_25_total_and_lines(self):
        """P-V 9.6185 um, straightness c L^2/4 = 2.420 um after any line, slope 49.6 arcsec."""
        lines = straightness_lines(Profile(X, y(X)))
        assert lines.total.value == pytest.approx(9.6185 * UM, abs=1e-4 * UM)
        for value in lines.straightness.values():
            assert value.value == pytest.approx(2.420 * UM, abs=1e-4 * UM)
        for slope in lines.slope.values():
            assert slope.value == pytest.approx(0.24046 * UM / MM, abs=1e-8)
        assert lines.audit["slope_least_squares_arcsec"] == pytest.approx(49.6, abs=0.05)
        assert "alignment" in lines.messages[0]

    def test_vertex(self):
        p = run_polynomial([Profile(X, y(X))], quantity="compensation", degree=2)
        vertex = -p.coefficients[1] / (2 * p.coefficients[2])
        assert vertex == pytest.approx(39.873 * MM, abs=1e-3 * MM)

    def test_lines_differ_where_they_should(self):
        """A bump on one side: minimum zone < least squares < end points, slopes apart."""
        z = np.where((X > 10 * MM) & (X < 12 * MM), 1 * UM, 0.0) + 5e-6 * X
        lines = straightness_lines(Profile(X, z), against="table")
        s = [lines.straightness[n].value for n in ("minimum-zone", "least-squares", "end-point")]
        assert s[0] <= s[1]
        assert s[0] <= s[2]
        assert s[2] == pytest.approx(1 * UM, abs=1 * NM)
        assert lines.slope["end-point"].value == pytest.approx(5e-6, abs=1e-12)
        assert "table" in lines.total.definition

    def test_too_few(self):
        with pytest.raises(TooFewSamplesError):
            straightness_lines(Profile([0.0, 1.0], [0.0, 1.0]))


class TestPolynomial:
    def test_exact(self):
        p = run_polynomial([Profile(X, y(X))] * 2, quantity="error", degree=2)
        scale = [UM, UM / MM, UM / MM**2]
        assert np.abs((p.coefficients - TRUTH) / scale).max() < 1e-12
        assert np.abs(p.evaluate(X) - y(X)).max() < 1e-6 * NM

    def test_covariance_is_that_of_repeated_experiments(self):
        rng = np.random.default_rng(11)
        found, stated = [], []
        for _ in range(150):
            p = run_polynomial(simulated_runs(rng), quantity="error", degree=2)
            found.append(p.coefficients)
            stated.append(p.u**2)
        # 150 trials tell a standard deviation to 6 %, the mean of 5-run variances to 6 %
        ratio = np.sqrt(np.mean(stated, axis=0)) / np.std(found, axis=0)
        assert ratio == pytest.approx(np.ones(3), abs=0.2)
        bias = (np.mean(found, axis=0) - TRUTH) / (np.std(found, axis=0) / np.sqrt(150))
        assert np.abs(bias).max() < 4.0

    def test_single_sample_least_squares_would_be_far_too_certain(self):
        """u(c0) ~ 0.02 um is drift: noise alone gives 20 nm 3/sqrt(401)/sqrt(5) ~ 1.3 nm."""
        p = run_polynomial(
            simulated_runs(np.random.default_rng(3), 40), quantity="error", degree=2
        )
        alone = 20 * NM * 3 / np.sqrt(401) / np.sqrt(40)
        assert p.u[0] > 5 * alone
        assert p.repeatability == pytest.approx(20 * NM, abs=1 * NM)
        assert any("drift" in m for m in p.messages)
        assert p.drift[:, 0].std(ddof=1) == pytest.approx(50 * NM, abs=15 * NM)

    @pytest.mark.parametrize(("rule", "share"), [("aicc", 0.744), ("f-test", 0.96)])
    def test_degree_is_found_as_often_as_theory_says(self, rule, share):
        """Truth is a parabola; four needless degrees are offered.

        AIC keeps degree 2 where no partial sum of (chi2_1 - 2) over them is positive: 74.4 % by
        simulation of just that. The F-test at 1 % fails in at most 4 x 1 %. Neither may go below 2.
        """
        n = 120
        found = [
            run_polynomial(
                simulated_runs(np.random.default_rng(1000 + i)), quantity="error", degree=rule
            ).degree
            for i in range(n)
        ]
        assert min(found) == 2
        sd = np.sqrt(share * (1 - share) / n)
        kept = np.mean(np.array(found) == 2)
        assert kept > share - 3 * sd
        if rule == "aicc":
            assert kept < share + 3 * sd

    def test_scores_of_every_degree(self):
        p = run_polynomial(simulated_runs(np.random.default_rng(5)), quantity="error")
        assert [s["degree"] for s in p.scores] == list(range(7))
        assert p.scores[p.degree]["aicc"] == min(s["aicc"] for s in p.scores)

    def test_sign_is_kept_and_stated(self):
        runs = simulated_runs(np.random.default_rng(0))
        as_error = run_polynomial(runs, quantity="error", degree=2)
        as_compensation = run_polynomial(runs, quantity="compensation", degree=2)
        assert (as_error.coefficients == as_compensation.coefficients).all()
        assert (as_error.error(X) == -as_compensation.error(X)).all()
        with pytest.raises(DataError, match="the sign follows"):
            run_polynomial(runs, quantity="auto")

    @pytest.mark.parametrize("start", [0.0, 0.2, 0.5, 3.0])
    @pytest.mark.parametrize("degree", [3, 6, 9])
    def test_far_from_zero_it_is_the_same(self, start, degree):
        """The scatter of runs knows nothing of where x = 0 lies: powers of x lose all digits."""
        rng = np.random.default_rng(4)
        shape = 1 * UM * (X / X[-1]) ** 3
        errors = [shape + 20 * NM * rng.standard_normal(X.size) for _ in range(12)]
        runs = [Profile(start + X, z) for z in errors]
        p = run_polynomial(runs, quantity="error", degree=degree)
        u = X / (20 * MM) - 1.0
        own = np.array([np.polyval(np.polyfit(u, z, degree), u) for z in errors])
        at = slice(None, None, 50)
        assert p.sd(start + X[at]) == pytest.approx(
            own.std(axis=0, ddof=1)[at] / np.sqrt(12), abs=1e-3 * NM
        )
        assert p.evaluate(start + X[at]) == pytest.approx(own.mean(axis=0)[at], abs=1e-3 * NM)

    def test_degrees_of_freedom_are_stated(self):
        """Three runs: Student's t of 2 degrees of freedom is 4.303 at 97.5 %."""
        p = run_polynomial(simulated_runs(np.random.default_rng(1), 3), quantity="error", degree=2)
        assert p.audit["cov_degrees_of_freedom"] == 2
        assert any("2 degrees of freedom" in m and "4.3 u" in m for m in p.messages)

    def test_domain_is_not_left(self):
        p = run_polynomial([Profile(X, y(X))], quantity="error", degree=2)
        with pytest.raises(LimitError, match=r"40\.1 mm"):
            p.evaluate([0.0, 40.1 * MM])
        assert np.isnan(p.sd(X)).all()
        assert any("one run" in m for m in p.messages)
        assert p.audit["u_um_mm"] is None

    def test_bad_runs(self):
        far = Profile(X + 1.0, y(X))
        with pytest.raises(DataError, match="share no range"):
            run_polynomial([Profile(X, y(X)), far], quantity="error")
        with pytest.raises(TooFewSamplesError):
            run_polynomial([], quantity="error")
        with pytest.raises(TooFewSamplesError):
            run_polynomial([Profile(X, np.full(X.size, np.nan))], quantity="error")
        with pytest.raises((TooFewSamplesError, DegenerateFitError)):
            run_polynomial([Profile(X[:4], y(X[:4]))], quantity="error", degree=5)
        for bad in ("best", -1, 21):
            with pytest.raises(DataError):
                run_polynomial([Profile(X, y(X))], quantity="error", degree=bad)


class TestStatic:
    def record(self, rng, sd, n=8000):
        r = 0.95
        noise = lfilter([1.0], [1.0, -r], rng.standard_normal(n + 500))[500:]
        return sd * np.sqrt(1 - r * r) * noise

    def test_twenty_decibel(self):
        """papers.md section 2: 200 nm -> 20 nm is 10 x, 20 dB; range95 of a normal = 3.92 sd."""
        rng = np.random.default_rng(2)
        found, stated = [], []
        for _ in range(8):
            c = compare_static(
                self.record(rng, 200 * NM / 3.92), self.record(rng, 20 * NM / 3.92), step=1e-3
            )
            found.append(c.ratio_db.value)
            stated.append(c.ratio_db.u)
        assert np.mean(found) == pytest.approx(20.0, abs=0.5)
        # the standard deviation of 8 values is known to 27 %
        assert np.mean(stated) == pytest.approx(np.std(found, ddof=1), abs=0.25)
        assert c.before["PV95"].value == pytest.approx(200 * NM, abs=15 * NM)

    def test_spikes_move_pv_and_rms_only(self):
        rng = np.random.default_rng(3)
        a, b = self.record(rng, 50 * NM), self.record(rng, 5 * NM)
        clean = compare_static(a, b, step=1e-3)
        spiky = b.copy()
        spiky[::400] += 300 * NM
        c = compare_static(a, spiky, step=1e-3)
        assert c.ratio_db.value == pytest.approx(clean.ratio_db.value, abs=0.3)
        assert c.after["PV"].value > 10 * clean.after["PV95"].value
        assert any("spikes" in m for m in c.messages)

    def test_density_integrates_to_the_variance(self):
        rng = np.random.default_rng(4)
        c = compare_static(
            10 * NM * rng.standard_normal(20000), NM * rng.standard_normal(20000), step=1e-3
        )
        variance = c.density_before.sum() * (c.frequency[1] - c.frequency[0])
        assert np.sqrt(variance) == pytest.approx(10 * NM, abs=0.2 * NM)

    def test_offset_is_reported_not_counted(self):
        rng = np.random.default_rng(5)
        a, b = self.record(rng, 50 * NM), self.record(rng, 5 * NM)
        c = compare_static(a, b + 3 * UM, step=1e-3)
        assert c.after["median"].value == pytest.approx(3 * UM, abs=2 * NM)
        assert c.ratio_db.value == pytest.approx(
            compare_static(a, b, step=1e-3).ratio_db.value, abs=1e-6
        )

    def test_no_improvement_is_said(self):
        rng = np.random.default_rng(6)
        c = compare_static(self.record(rng, NM), self.record(rng, NM), step=1e-3)
        assert any("no improvement" in m for m in c.messages)

    def test_gaps_and_bad_records(self):
        rng = np.random.default_rng(7)
        a, b = self.record(rng, 50 * NM), self.record(rng, 5 * NM)
        a[100:200] = np.nan
        c = compare_static(a, b, step=1e-3, resolution=12 * NM)
        assert c.audit["samples_not_measured"] == (100, 0)
        assert any("sensor" in m for m in c.messages)
        with pytest.raises(TooFewSamplesError, match="after has 1"):
            compare_static(a, [0.0], step=1e-3)
        with pytest.raises(DataError, match="constant"):
            compare_static(a, np.zeros(100), step=1e-3)
        with pytest.raises(DataError, match="step"):
            compare_static(a, b, step=0.0)


class TestCumulative:
    def test_row_29(self):
        """Cumulative = FE + s(x), command = negated, the sum is 0 to 1e-12."""
        rng = np.random.default_rng(8)
        fe = 100 * NM * rng.standard_normal(X.size)
        p = run_polynomial(simulated_runs(rng), quantity="error", degree=2)
        c = cumulative_error(X, fe, p)
        assert np.abs(c.error - (fe + p.evaluate(X))).max() < 1e-12 * UM
        assert np.abs(c.error + c.command).max() == 0.0
        left = fe + y(X) + c.command
        assert np.abs(left).max() < 4 * c.u.max() + 1 * NM
        wrong = fe + y(X) - c.command
        assert np.ptp(wrong) > 1.9 * np.ptp(fe + y(X))

    def test_compensation_is_turned(self):
        """Eq. 1 is a displacement of the stage, so the error is its negative."""
        p = run_polynomial([Profile(X, y(X))], quantity="compensation", degree=2)
        c = cumulative_error(X, np.zeros(X.size), p)
        assert np.abs(c.command - y(X)).max() < 1e-6 * NM
        by_array = cumulative_error(X, np.zeros(X.size), y(X), quantity="compensation")
        by_call = cumulative_error(X, np.zeros(X.size), y, quantity="compensation")
        assert (by_array.command == by_call.command).all()

    def test_bad(self):
        p = run_polynomial([Profile(X, y(X))], quantity="error", degree=2)
        with pytest.raises(DataError, match="not the compensation"):
            cumulative_error(X, 0 * X, p, quantity="compensation")
        with pytest.raises(DataError, match="the sign follows"):
            cumulative_error(X, 0 * X, y(X))
        with pytest.raises(InvalidSamplesError, match="belong"):
            cumulative_error(X, [0.0], y(X), quantity="error")
        with pytest.raises(InvalidSamplesError, match="index 0"):
            cumulative_error([np.nan], [0.0], [0.0], quantity="error")
        c = cumulative_error([0.0, 1.0], [0.0, np.nan], [0.0, 0.0], quantity="error")
        assert np.isnan(c.command[1])
        assert "hold the stage" in c.messages[0]


class TestBeforeAfter:
    def profiles(self):
        x = np.arange(8000) * 0.5e-6
        wave = np.sin(2 * np.pi * x / 20e-6)
        bow = 0.6 * UM * (2 * x / x[-1] - 1) ** 2
        return Profile(x, 48 * NM * np.pi / 2 * wave + bow), Profile(x, 4 * NM * np.pi / 2 * wave)

    def test_ra_of_sines(self):
        """A sine of amplitude a has Ra 2a/pi; the paper's 48 and 4 nm."""
        r = before_after(*self.profiles(), lambda_c=0.25 * MM)
        assert r.before["Ra"].value == pytest.approx(48 * NM, abs=0.5 * NM)
        assert r.after["Ra"].value == pytest.approx(4 * NM, abs=0.05 * NM)
        assert r.ratio["Ra"] == pytest.approx(12.0, abs=0.1)
        assert r.before["Pt"].value == pytest.approx((600 + 2 * 75.4) * NM, abs=10 * NM)
        assert "lambda_c 0.25 mm" in r.before["Ra"].definition
        assert "form removed: line" in r.before["Pt"].definition

    def test_form_is_part_of_pt(self):
        before, after = self.profiles()
        tilted = Profile(before.x, before.z + 1e-3 * before.x)
        line = before_after(tilted, after, lambda_c=0.25 * MM)
        none = before_after(tilted, after, lambda_c=0.25 * MM, form="none")
        assert none.before["Pt"].value > line.before["Pt"].value + 3 * UM
        assert none.before["Ra"].value == pytest.approx(line.before["Ra"].value, abs=1e-3 * NM)

    def test_same_region(self):
        before, after = self.profiles()
        short = after.crop(1 * MM, 2 * MM)
        r = before_after(before, short, lambda_c=0.08 * MM)
        assert r.region == pytest.approx((1 * MM, 2 * MM), abs=1e-9)
        assert r.profiles[0].x[0] == pytest.approx(r.profiles[1].x[0], abs=1e-9)
        with pytest.raises(DataError, match="not measured in both"):
            before_after(before, short, lambda_c=0.08 * MM, region=(0.0, 2 * MM))

    def test_worse_is_said(self):
        before, after = self.profiles()
        r = before_after(after, before, lambda_c=0.25 * MM)
        assert "Ra became worse: check the sign" in r.messages

    def test_options(self):
        with pytest.raises(DataError, match="form"):
            before_after(*self.profiles(), lambda_c=0.25 * MM, form="arc")
        far = Profile(np.arange(100) * 1e-6 + 1.0, np.zeros(100))
        with pytest.raises(DataError, match="share"):
            before_after(self.profiles()[0], far, lambda_c=0.25 * MM)
