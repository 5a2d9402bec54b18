"""Live forces of coupled components, against the whole-record way and for any chunking."""

import numpy as np
import pytest

from aerobalance.dynamics.coupled import CoupledDynamics
from aerobalance.dynamics.decoupling import DecoupledChannel
from aerobalance.dynamics.rigid_body import RigidMass
from aerobalance.estimation.decoupled_record import balance_load
from aerobalance.estimation.least_squares import generalised_least_squares
from aerobalance.estimation.live.decoupling import MARGIN, Decoupler
from aerobalance.estimation.live.live_force import JUDGED, LiveForce
from aerobalance.estimation.live.platform import LiveChannel, LivePlatform
from aerobalance.estimation.live.settings import LiveSettings
from aerobalance.estimation.observation import Observation, SpectralPrior
from aerobalance.estimation.spectra.periodogram import Spectrum
from aerobalance.estimation.statespace.kalman import FORCE, KalmanFilter
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError
from aerobalance.recording.gravity import gravity_components
from aerobalance.simulation.six_balance import CoupledBalance, random_balance
from aerobalance.simulation.six_components import GROUND_CHANNELS, RATE_CHANNELS, SixComponentRig
from aerobalance.simulation.six_signals import Band, broadband, random_motion
from helpers.butterworth import butterworth

RATE = 10_000.0


ALL = LiveSettings(samples_a_period=np.inf)
"""Without decimation."""


def felt(generator: np.random.Generator, balance: CoupledBalance, count: int, *, rms: float = 0.05) -> np.ndarray:
    """Readings of a balance under broadband loads to 150 Hz, with its noise."""
    force = broadband(generator, Band(0, 150), rms=rms * balance.half_range, period=2 * count / RATE)
    exact = balance_load(balance.dynamics, force(np.arange(count) / RATE), interval=1 / RATE)
    return exact + noise_of(balance) * generator.standard_normal((count, 6))


def noise_of(balance: CoupledBalance) -> np.ndarray:
    return balance.noise * balance.half_range


def channels_of(balance: CoupledBalance) -> list[DecoupledChannel]:
    noise = np.diag(noise_of(balance) ** 2)
    return [balance.dynamics.decoupled(name, noise=noise) for name in COMPONENTS]


def chunks(generator: np.random.Generator, count: int, most: int) -> list[slice]:
    edges = np.unique(np.minimum(np.cumsum(generator.integers(0, most, count)), count))
    return [slice(first, stop) for first, stop in zip([0, *edges], [*edges, count], strict=True)]


def apart(generator: np.random.Generator, channels, readings, net=None, *, most: int = 400) -> np.ndarray:
    live = Decoupler(channels, interval=1 / RATE, moves=net is not None)
    net = np.zeros(readings.shape) if net is None else net
    parts = [live.push(readings[part], net[part]) for part in chunks(generator, len(readings), most)]
    return np.concatenate([*parts, live.finish()])


def from_rest(count: int) -> np.ndarray:
    """Factor by which loads rise from nothing over 0.1 s and fall to it again, shape (count, 1)."""
    edge = np.minimum(np.arange(count), np.arange(count)[::-1]) * 10.0 / RATE
    return np.sin(np.pi / 2 * np.minimum(edge, 1.0))[:, None] ** 2


def largest(balance: CoupledBalance, readings: np.ndarray, place: int) -> float:
    """Largest sum of what the loads, at 600 Hz at most, weigh in a channel reading."""
    weight = np.abs(balance.dynamics.inertia[place]) * (2 * np.pi * 600) ** 2
    weight[place] += 1
    return float(np.max(np.abs(readings) @ weight))


def test_the_stream_drained_is_the_whole_record(rng):
    balance = random_balance(rng)
    readings = felt(rng, balance, 4000)
    found = apart(rng, channels_of(balance), readings)
    for place, channel in enumerate(channels_of(balance)):
        expected = channel.reading(readings, interval=1 / RATE)
        # the same sums in another order: 2e-16 of each of a hundred products, kept for a memory of 1e3 samples
        assert np.abs(found[:, place] - expected).max() < 2e-11 * largest(balance, readings, place), channel.component


def test_hidden_coordinates_are_taken_apart_too(rng):
    mass = np.array([[20.0, 1.0, 0.6], [1.0, 0.6, 0.05], [0.6, 0.05, 0.4]])
    size = np.sqrt(np.diag(mass)) * 2 * np.pi * np.array([70.0, 130.0, 210.0])
    inertia = mass @ np.linalg.inv(np.outer(size, size) * (np.eye(3) + 0.1 * np.ones((3, 3))))
    dynamics = CoupledDynamics(("NF", "PM"), inertia, 2e-2 * 2 * np.pi * 120 * inertia)
    assert dynamics.internal == 1
    force = broadband(rng, Band(0, 150), rms=np.full(6, 50.0), period=1.0)(np.arange(4000) / RATE)[:, :2]
    force *= from_rest(4000)
    readings = balance_load(dynamics, force, interval=1 / RATE)
    channels = [dynamics.decoupled(name, noise=np.diag([1.0, 0.01])) for name in dynamics.components]
    found, freed = apart(rng, channels, readings), apart(rng, channels, readings, force)
    for place, channel in enumerate(channels):
        assert len(channel.dynamics.modes) == 2
        # in the reading each load weighs some ten times itself; rounding as above, and what the weights of an
        # interpolated value leave of a load far below the sampling rate, all of which is known here
        reach = 1e1 * np.abs(readings).max()
        assert np.abs(found[:, place] - channel.reading(readings, interval=1 / RATE)).max() < 2e-11 * reach, (
            channel.component
        )
        assert np.abs(freed[:, place]).max() < 3e-6 * reach, channel.component


def test_chunks_do_not_matter_when_taken_apart(rng):
    balance = random_balance(rng)
    readings = felt(rng, balance, 2000)
    readings[rng.integers(300, 1900, 3), rng.integers(0, 6, 3)] = np.nan
    net = rng.standard_normal((2000, 6))
    channels = channels_of(balance)
    once = apart(rng, channels, readings, net, most=4000)
    for most in (3, 100):
        other = apart(rng, channels, readings, net, most=most)
        assert np.array_equal(other, once, equal_nan=True), most


def test_components_wait_for_the_first_reading_of_each_other(rng):
    """Whatever is there before, a mixed reading begins when all have been read once."""
    balance = random_balance(rng)
    readings = felt(rng, balance, 3000)
    readings[:500, 2] = np.nan
    whole = apart(rng, channels_of(balance), readings, most=6000)
    live = Decoupler(channels_of(balance), interval=1 / RATE, moves=False)
    net = np.zeros(readings.shape)
    assert live.push(readings[:400], net[:400]).shape == (0, 6)
    rest = [live.push(readings[400:900], net[400:900]), live.push(readings[900:], net[900:]), live.finish()]
    np.testing.assert_array_equal(np.concatenate(rest), whole)


def test_a_stream_that_begins_anew_leaves_out_what_has_no_force(rng):
    """A component that was never read has no force; where the ground begins to move, the others begin anew."""
    count, rate = 6000, 2500.0
    readings = rng.normal(0, [0.2, 0.01], (count, 2))
    readings[:, 0] = np.nan
    ground = rng.normal(0, 0.01, count) + np.where(np.arange(count) > 3000, 5 * np.sin(np.arange(count) / 5), 0)
    live = LiveForce(
        pair(), rate=rate, noise=np.diag([0.2, 0.01]) ** 2, settings=LiveSettings(samples_a_period=np.inf)
    )
    found = run(rng, live, readings, ground_acceleration_z=ground)  # which sees that no sample is passed over
    assert live.generation > 1
    assert np.isnan(found["NF"]).all()


def test_known_loads_are_taken_off(rng):
    balance = random_balance(rng)
    count = 3000
    known = broadband(rng, Band(0, 150), rms=0.1 * balance.half_range, period=1.0)(np.arange(count) / RATE)
    known *= from_rest(count)
    readings = felt(rng, balance, count)
    more = readings + balance_load(balance.dynamics, known, interval=1 / RATE)
    channels = channels_of(balance)
    difference = apart(rng, channels, more, known) - apart(rng, channels, readings)
    for place, channel in enumerate(channels):
        # the band-limited interpolation is good to 1e-4 of a load and equivalent models leave a tenth of that;
        # straight lines on the finer clock leave less
        assert np.abs(difference[:, place]).max() < 2e-5 * largest(balance, more, place), channel.component


def test_gap_spoils_its_surroundings_alone(rng):
    balance = random_balance(rng)
    readings = felt(rng, balance, 2000)
    gappy = readings.copy()
    gappy[1000:1030, 2] = np.nan
    channels = channels_of(balance)
    whole, found = apart(rng, channels, readings), apart(rng, channels, gappy)
    missing = np.flatnonzero(np.isnan(found).any(axis=1))
    assert (missing[0], missing[-1]) == (1000 - MARGIN, 1029 + MARGIN)
    assert np.array_equal(found[: 1000 - MARGIN], whole[: 1000 - MARGIN])


def process(*, rms: float, cutoff: float, noise: float) -> SpectralPrior:
    density = rms**2 / (2 * cutoff)
    spectrum = Spectrum(np.array([np.inf]), np.array([density]), (cutoff, 4.0, 1.0))
    return SpectralPrior(spectrum, butterworth(2, cutoff=cutoff, density=density), noise)


def started(generator: np.random.Generator, **settings) -> tuple[CoupledBalance, LiveForce]:
    """A balance and its live forces with processes that suit `felt`."""
    balance = random_balance(generator)
    learned = {
        name: process(rms=0.05 * size, cutoff=150.0, noise=float(noise))
        for name, size, noise in zip(COMPONENTS, balance.half_range, noise_of(balance), strict=True)
    }
    covariance = np.diag(noise_of(balance) ** 2)
    dynamics = settings.pop("dynamics", balance.dynamics)
    return balance, LiveForce(dynamics, rate=RATE, learned=learned, noise=covariance, settings=ALL)


def run(generator, live: LiveForce, readings: np.ndarray, *, most: int = 500, **channels) -> dict:
    """Force and uncertainty of every component, shape (samples, 2), from chunks of any size."""
    columns = dict(zip(live.components, readings.T, strict=True)) | channels
    parts = [
        live.push({name: values[part] for name, values in columns.items()})
        for part in chunks(generator, len(readings), most)
    ]
    parts.append(live.finish())
    for name in live.components:
        counts = [part[name].force.size for part in parts]
        assert [part[name].first for part in parts] == [0, *np.cumsum(counts)[:-1]]
    return {
        name: np.column_stack(
            [np.concatenate([getattr(p[name], what) for p in parts]) for what in ("force", "uncertainty")]
        )
        for name in live.components
    }


def test_live_is_the_smoother_of_the_decoupled_reading(rng):
    balance, live = started(rng)
    readings = felt(rng, balance, 4000)
    found = run(rng, live, readings)
    for channel in channels_of(balance):
        part = dict(live._named_parts())[channel.component]
        reading = channel.reading(readings, interval=1 / RATE)
        learned = part.settings.learned
        for k in rng.integers(1500, 3900, 2):
            seen = reading[: k + part.settings.lag + 1]
            system = Observation(reading[: part.settings.lag // 2], 1 / RATE, channel.dynamics).system(learned)
            filter_ = KalmanFilter.of(system, np.isfinite(seen))
            (size,), ((variance,),), _ = generalised_least_squares(filter_, seen, np.ones((seen.size, 1)))
            states, spread = filter_.smooth((seen - size)[:, None])[:, 0], filter_.smoothed_variance
            slope = 1 - filter_.smooth(np.ones((seen.size, 1)))[k, 0, FORCE]
            value, deviation = states[k, FORCE] + size, np.sqrt(spread[k] + variance * slope**2)
            force, uncertainty = found[channel.component][k]
            # as for one component, where the gain changes slowly; the readings differ by 1e-5 of a noise of 1e-4
            assert abs(force - value) < 1e-2 * deviation, (channel.component, k)
            assert uncertainty == pytest.approx(deviation, rel=2e-3), (channel.component, k)


def pair() -> CoupledDynamics:
    """Two coupled components at some 60 and 170 Hz."""
    mass = RigidMass(20.0, np.array([0.05, 0.0, 0.01]), np.diag([0.1, 0.6, 0.6]))
    inertia = mass.matrix[:2, :2] @ np.linalg.inv(np.array([[9e6, 4e4], [4e4, 1.2e5]]))
    return CoupledDynamics(("NF", "PM"), inertia, 2e-2 * inertia * 2 * np.pi * 100, mass=mass)


@pytest.mark.parametrize("what", ["learned", "learning", "gaps", "ground"])
def test_chunks_do_not_matter(what, rng):
    dynamics, rate, count = pair(), 2500.0, 2000
    time = np.arange(count)[:, None] / rate
    force = np.array([100.0, 5.0]) * sum(np.sin(2 * np.pi * (f * time + rng.random(2))) for f in (7, 19, 33, 51))
    readings = dynamics.balance_load(force, interval=1 / rate) + rng.normal(0, [0.2, 0.01], (count, 2))
    channels, settings, noise = {}, LiveSettings(learn_inside=False, samples_a_period=np.inf), None
    if what == "learned":
        noise = np.diag([0.2, 0.01]) ** 2
    if what == "learning":
        settings = LiveSettings(first_learning=0.3, last_learning=0.3, learned_from=750, samples_a_period=np.inf)
    if what == "gaps":
        readings[rng.integers(0, count, 4), rng.integers(0, 2, 4)] = np.nan
    if what == "ground":
        # a tone beside the noise, so that the ground end is seen to move
        shaken = rng.normal(0, 0.1, (9, count)) + np.sin(2 * np.pi * 31 * time[:, 0])
        channels = dict(zip((*GROUND_CHANNELS, *RATE_CHANNELS), shaken, strict=True))
        channels |= {"pitch": np.linspace(0, 0.1, count), "roll": np.linspace(0.1, 0, count)}

    def forces(most: int) -> tuple[dict, dict]:
        live = LiveForce(dynamics, rate=rate, noise=noise, settings=settings)
        return run(rng, live, readings, most=most, **channels), live.health

    once, health = forces(5000)
    assert health["NF"].samples == count
    assert sum(one.missing for one in health.values()) == np.count_nonzero(np.isnan(readings))
    other, same = forces(300)
    for name in dynamics.components:
        # the same operations in the same order
        assert np.array_equal(other[name], once[name]), name
    assert same == health


def test_errors_are_as_large_as_said(rng):
    """Ground shaken, gravity turning, a gap in one channel and one at its limit."""
    balance = random_balance(rng)
    base = random_motion(rng, Band(5, 300), rms=[1, 5, 1, 5, 5, 1], period=4.0)
    rig = SixComponentRig(
        balance,
        applied=broadband(rng, Band(0, 150, 4), rms=0.05 * balance.half_range, period=4.0),
        base=base,
        pitch=lambda time: 0.1 * time,
        output="loads",
        rate=RATE,
    )
    simulation = rig.run(1.2, rng)
    readings = np.column_stack([simulation.recording.channel(name).values for name in COMPONENTS])
    ground = np.column_stack([simulation.recording.channel(name).values for name in GROUND_CHANNELS])
    readings[8000:8040, 1] = np.nan
    noise = [balance.turn_noise if "turn" in name else balance.acceleration_noise for name in GROUND_CHANNELS]
    learned = {
        name: process(rms=0.05 * size, cutoff=150.0, noise=float(noise))
        for name, size, noise in zip(COMPONENTS, balance.half_range, noise_of(balance), strict=True)
    }
    sensors = [LiveChannel(name, noise=one) for name, one in zip(GROUND_CHANNELS, noise, strict=True)]
    live = LiveForce(
        balance.dynamics,
        rate=RATE,
        channels=[*COMPONENTS, *sensors, *RATE_CHANNELS, "pitch", "roll"],
        learned=learned,
        noise=np.diag(noise_of(balance) ** 2),
        settings=ALL,
    )
    motion = dict(zip((*GROUND_CHANNELS, *RATE_CHANNELS), np.hstack([ground, simulation.rate]).T, strict=True))
    found = run(rng, live, readings, pitch=simulation.pitch, roll=simulation.roll, **motion)
    ratios = []
    for place, name in enumerate(COMPONENTS):
        assert not live.steps[name]
        error = (found[name][:, 0] - simulation.applied[:, place]) / found[name][:, 1]
        ratios.append(np.sqrt(np.mean(error[3000:11_000] ** 2)))
        assert np.abs(error[7900:8200]).max() < 8, name  # the process is not that of the load's spectrum
    # flat processes in place of the load's own: the errors are below what they say, but of its order
    assert 0.3 < np.mean(ratios) < 1.2, ratios


def changed_at(
    dynamics: CoupledDynamics, place: tuple[int, int, int], by: float
) -> tuple[CoupledDynamics, np.ndarray]:
    """The same with one element of inertia or damping changed, in a direction that leaves it stable; the changes."""
    for change in (by, -by, by / 10, -by / 10):
        changes = np.zeros((2, 6, 6))
        changes[place] = change
        try:
            changed = CoupledDynamics(COMPONENTS, dynamics.inertia + changes[0], dynamics.damping + changes[1])
        except ValueError:
            continue
        return changed, changes
    raise AssertionError("every change makes it unstable")


@pytest.mark.parametrize("kind", [0, 1], ids=["inertia", "damping"])
@pytest.mark.soak(first=1)
def test_uncertain_elements_are_in_the_uncertainty(kind, rng):
    balance, plain = started(rng)
    readings = felt(rng, balance.without_noise(), 4000)
    true = balance.dynamics
    row, column = (int(place) for place in rng.integers(0, 6, 2))
    own = abs((true.inertia, true.damping)[kind][row, row]) * balance.half_range[row] / balance.half_range[column]
    changed, changes = changed_at(true, (kind, row, column), 1e-2 * own)
    doubtful = CoupledDynamics(COMPONENTS, true.inertia, true.damping, np.diag(changes.ravel() ** 2))
    settings = {"rate": RATE, "settings": ALL, "learned": plain._learned, "noise": np.diag(noise_of(balance) ** 2)}
    found = [
        run(rng, LiveForce(dynamics, **settings), readings)[COMPONENTS[row]][1500:3500]
        for dynamics in (true, changed, doubtful)
    ]
    change = found[1][:, 0] - found[0][:, 0]
    said = np.sqrt(found[2][:, 1] ** 2 - found[0][:, 1] ** 2)
    # a force changes in proportion to 1 % of an element, the rates of loads to 150 Hz by central differences are short
    # by (w h)^2 / 6 = 0.1 %, and of their band the smoother passes all but its soft edge
    assert np.sqrt(np.mean(said**2)) == pytest.approx(np.sqrt(np.mean(change**2)), rel=0.1)


def test_noise_is_judged_from_the_first_readings(rng):
    balance = random_balance(rng)
    live = LiveForce(balance.dynamics, rate=RATE, settings=LiveSettings(learn_inside=False, samples_a_period=np.inf))
    readings = felt(rng, balance, JUDGED + 2000)
    assert live.push(readings[: JUDGED - 1])["NF"].force.size == 0
    assert live.lag == 0
    assert not live.health
    live.push(readings[JUDGED - 1 :])
    assert live.lag > 0
    assert set(live.health) == set(COMPONENTS)


@pytest.mark.parametrize("count", [0, 1, 7, 8, 200])
@pytest.mark.parametrize("ground", [False, True], ids=["alone", "with the ground"])
def test_a_stream_that_ends_before_its_noise_is_judged_is_judged_by_what_there_is(ground, count, rng):
    """As of one component, eight readings are the fewest that tell a noise and have a force."""
    channels = ["NF", "PM", *(["ground_acceleration_z"] if ground else [])]
    live = LiveForce(pair(), rate=2500.0, channels=channels, settings=LiveSettings(samples_a_period=np.inf))
    readings = rng.normal(size=(count, len(channels))) * np.array([0.2, 0.01, 0.1][: len(channels)])
    pushed, drained = live.push(readings), live.finish()
    for name in live.components:
        assert pushed[name].force.size == 0
        assert drained[name].force.size == (count if count >= 8 else 0)
        assert np.isfinite(drained[name].force).all()


def test_sensors_of_the_ground_end_tell_its_motion(rng):
    motion, (pitch, roll) = rng.normal(size=(5, 6)), rng.uniform(-1, 1, (2, 5))
    places = rng.uniform(-0.5, 0.5, (7, 3))
    axes = rng.normal(size=(7, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    sensors = [
        LiveChannel(
            f"ground_acceleration_{number}",
            axis=tuple(axis),
            place=tuple(place),
            coupling="dc" if number < 3 else "kinematic",
        )
        for number, (axis, place) in enumerate(zip(axes, places, strict=True))
    ]
    # by hand: the acceleration of a place is that of the centre and turn x place, and gravity is read as well
    along = {"NF": (0, 0, 1), "SF": (0, 1, 0), "AF": (1, 0, 0), "PM": (0, 1, 0), "YM": (0, 0, -1), "RM": (-1, 0, 0)}
    centre = sum(motion[:, [COMPONENTS.index(name)]] * along[name] for name in ("NF", "SF", "AF"))
    turn = sum(motion[:, [COMPONENTS.index(name)]] * along[name] for name in ("PM", "YM", "RM"))
    down = 9.80665 * np.column_stack([np.sin(pitch), np.cos(pitch) * np.sin(roll), -np.cos(pitch) * np.cos(roll)])
    read = [
        (centre + np.cross(turn, place) - (down if sensor.specific else 0)) @ axis
        for sensor, place, axis in zip(sensors, places, axes, strict=True)
    ]
    pull = gravity_components(pitch, roll, gravity=9.80665)
    found = LivePlatform.of(sensors).specific_force(np.column_stack(read), pull=pull) + pull
    # rounding, times the condition of random places: a thousand and more once in a thousand draws
    assert found == pytest.approx(motion, abs=1e-7)


def test_sensors_without_an_axis_are_left_out():
    platform = LivePlatform.of(
        [LiveChannel("ground_acceleration_9"), LiveChannel("ground_turn_PM"), LiveChannel("ground_turn_rate_RM")]
    )
    found = platform.specific_force(np.array([[5.0, 2.0, 3.0]]), pull=None)
    assert found.tolist() == [[0, 2.0, 0, 0, 0, 0]]
    assert platform.turn_rate(np.array([[5.0, 2.0, 3.0]])).tolist() == [[0, 0, 3.0]]


def test_wrong_calls():
    balance = random_balance(np.random.default_rng(0))
    live = LiveForce(balance.dynamics, rate=RATE)
    with pytest.raises(ValueError, match="a column for each of NF, PM"):
        live.push(np.zeros((10, 5)))
    with pytest.raises(ValueError, match="there is no RM among"):
        LiveForce(balance.dynamics, rate=RATE, channels=["NF", "PM", "SF", "YM", "AF"])
    with pytest.raises(ValueError, match="PM stands twice among NF, PM"):
        LiveForce(balance.dynamics, rate=RATE, channels=[*COMPONENTS, "PM"])
    with pytest.raises(FitError, match="no readings of NF yet"):
        live.snapshot("NF")
    bare = CoupledDynamics(COMPONENTS, balance.dynamics.inertia, balance.dynamics.damping)
    with pytest.raises(ValueError, match=r"hold no mass.*or leave out pitch"):
        LiveForce(bare, rate=RATE, channels=[*COMPONENTS, "pitch"])
