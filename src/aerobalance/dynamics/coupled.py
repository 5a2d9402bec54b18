r"""Several coupled components: F = X + D X' + A X'' with matrices for D and A.

X are the balance loads and F the loads applied, both in the order of the components. A = M K^-1 and D = C K^-1 carry
the mass, damping and stiffness matrices of Eq. (8) of [Gorbushin2020]_ written for several components, so that F is
Eq. (17) with matrices in place of M/k and b/k. A diagonal A and D is the paper's way, each component for itself.

Where the model or the sting bends there are more modes than components: the loads Y in springs that no channel shows
are coordinates as well, [F; 0] = [X; Y] + D [X; Y]' + A [X; Y]''. Whatever way the force has into them is undone by
other coordinates T Y + S X, so nothing is lost by the zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerobalance.dynamics._kernels import add_mode
from aerobalance.dynamics.balance_dynamics import BalanceDynamics, ForceSlopes
from aerobalance.dynamics.condensation import Condensed
from aerobalance.dynamics.decoupling import DecoupledChannel, parameter_rows
from aerobalance.dynamics.independent import dynamics_of
from aerobalance.dynamics.modal import EquivalentModel, Mode, Modes
from aerobalance.dynamics.rigid_body import RigidMass, mass_slopes
from aerobalance.dynamics.single import Dynamics
from aerobalance.recording.channel import Array
from aerobalance.recording.components import COMPONENTS
from aerobalance.recording.errors import FitError


def internal_names(count: int) -> tuple[str, ...]:
    """What internal coordinates are called."""
    return tuple(f"hidden {number}" for number in range(1, count + 1))


class ModalForm(NamedTuple):
    """Free motion of coupled components as 2 N modes z' = pole z + weight @ net load, balance loads = sum shape z.

    Attributes
    ----------
    poles
        Shape (2 N,) [rad/s], in conjugate pairs where they oscillate.
    shapes
        Balance loads by mode, shape (n, 2 N).
    weights
        What each mode takes of the net load, shape (2 N, n).
    """

    poles: NDArray[np.complex128]
    shapes: NDArray[np.complex128]
    weights: NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class CoupledDynamics(BalanceDynamics):
    """Dynamics of several components at once.

    Attributes
    ----------
    components
        Which components, n of them, in the order of `COMPONENTS`.
    inertia
        A = M K^-1, shape (N, N); the unit of row i over that of column j [s^2]. The N - n rows and columns behind
        those of the components are of internal coordinates, whose unit is free.
    damping
        D = C K^-1, shape (N, N); the unit of row i over that of column j [s].
    covariance
        Covariance of `parameters`, in the units of these, shape (2 N^2, 2 N^2), as the readings that they were found
        from leave it; all zero where not given. With the balance matrix of these readings it is the one to work out
        a force with: what is linear in the errors of that matrix is in the loads and in the dynamics alike, and is
        counted once, with the matrix.
    mass
        What the ground's motion and gravity act on; None where it is not known.
    covariance_of_calibration
        What the calibration of the balance leaves in `parameters` beside that, in the same units, shape
        (2 N^2, 2 N^2); all zero where not known.
    balance
        SHA-256 of the file of the balance matrix that has this calibration; empty where it is not known.
    """

    components: tuple[str, ...] = field()  # else the abstract property would be its default
    inertia: Array = field()
    damping: Array = field()
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    mass: RigidMass | None = None
    covariance_of_calibration: Array = field(default_factory=lambda: np.zeros((0, 0)))
    balance: str = ""

    def __post_init__(self) -> None:
        if not self.components or tuple(c for c in COMPONENTS if c in self.components) != tuple(self.components):
            raise ValueError(f"components must be some of {', '.join(COMPONENTS)}, in this order and each once")
        n = max(len(self.components), len(self.inertia))
        for name in ("inertia", "damping"):
            value = getattr(self, name)
            if value.shape != (n, n) or not np.isfinite(value).all():
                raise ValueError(f"{name} must have shape ({n}, {n}) and be finite")
        for name in ("covariance", "covariance_of_calibration"):
            if getattr(self, name).size == 0:
                object.__setattr__(self, name, np.zeros((2 * n * n, 2 * n * n)))
            value = getattr(self, name)
            if value.shape != (2 * n * n, 2 * n * n):
                raise ValueError(f"{name} must have shape ({2 * n * n}, {2 * n * n}), not {value.shape}")
            if not np.isfinite(value).all() or (np.diag(value) < 0).any():
                raise ValueError(f"{name} must be finite, with variances of zero or more")
        try:
            generator = self._generator
        except np.linalg.LinAlgError:
            # a ValueError by class, which whoever searches for dynamics passes over
            raise np.linalg.LinAlgError(
                "inertia has no inverse: rows of it are zeros or depend on each other"
            ) from None
        if not (np.linalg.eigvals(generator).real < 0).all():
            raise ValueError("inertia and damping make a free oscillation that grows or never ends")

    def __repr__(self) -> str:
        mass = "mass not known" if self.mass is None else f"mass {self.mass.mass:.6g} kg"
        return f"coupled dynamics of {', '.join(self.components)}; {mass}; {self.modes!r}"

    @classmethod
    def of_components(cls, parts: Sequence[Dynamics]) -> CoupledDynamics:
        """Components that are not coupled, one mode each: the paper's way, with diagonal matrices."""
        if any(part.further_modes for part in parts):
            raise ValueError("components with further modes of their own cannot be put into one set of matrices")
        apart = dynamics_of(sorted(parts, key=lambda part: COMPONENTS.index(part.component)))
        n, (damping, inertia) = len(parts), apart.quadratic
        covariance = np.zeros((2 * n * n, 2 * n * n))
        for place, own in enumerate(apart.row_covariance):
            row, where = [place, n + place], [place * (n + 1), n * n + place * (n + 1)]  # of A and D
            covariance[np.ix_(where, where)] = own[np.ix_(row, row)]
        return cls(apart.components, inertia, damping, covariance)

    @classmethod
    def of_rigid_mass(cls, mass: RigidMass, *, stiffness: Array, damping: Array) -> CoupledDynamics:
        """All six components of a rigid mass on springs and dampers: A = M K^-1, D = C K^-1.

        Parameters
        ----------
        mass
            The moving mass.
        stiffness
            K, load over displacement and turn of the balance's centre, shape (6, 6) [N/m, N, N*m].
        damping
            C, load over their rates, shape (6, 6) [N*s/m, N*s, N*m*s].
        """
        flexibility = np.linalg.inv(stiffness)
        return cls(COMPONENTS, mass.matrix @ flexibility, damping @ flexibility, mass=mass)

    @property
    def total_covariance(self) -> Array:
        """Covariance of `parameters` from readings and calibration together, shape (2 N^2, 2 N^2)."""
        return np.asarray(self.covariance + self.covariance_of_calibration)

    @property
    def calibration(self) -> str | None:
        """Digest of the balance matrix whose calibration is in `covariance_of_calibration`; None without one."""
        return self.balance if self.covariance_of_calibration.any() else None

    @property
    def with_calibration(self) -> CoupledDynamics:
        """The same for what does not know the calibration by itself: all that is not known is in `covariance`."""
        nothing = np.zeros_like(self.covariance)
        return replace(self, covariance=self.total_covariance, covariance_of_calibration=nothing, balance="")

    @property
    def parameter_values(self) -> Array:
        """Values of `parameters`, shape (2 N^2,)."""
        return np.concatenate([self.inertia.ravel(), self.damping.ravel()])

    def with_parameters(self, values: Array, mass: RigidMass | None = None) -> CoupledDynamics:
        """The same with other values of `parameters`, shape (2 N^2,), known exactly, and with this mass."""
        inertia, damping = values.reshape(2, *self.inertia.shape)
        return CoupledDynamics(self.components, inertia, damping, mass=mass)

    @property
    def exact(self) -> CoupledDynamics:
        """The same, taken as known exactly, and its mass too."""
        mass = self.mass and RigidMass.of_values(self.mass.values)
        return CoupledDynamics(self.components, self.inertia, self.damping, mass=mass)

    @property
    def internal(self) -> int:
        """Number of internal coordinates: modes beyond one for each component."""
        return len(self.inertia) - len(self.components)

    @property
    def has_one_mode_each(self) -> bool:
        """Whether there are as many oscillations as components, and no internal coordinates."""
        return not self.internal and len(self.modes) == len(self.components)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the N rows of the matrices: the components, then hidden 1, hidden 2 and so on."""
        return (*self.components, *internal_names(self.internal))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the rows of `covariance`: the inertia row by row, then the damping."""
        names = self.coordinates
        return tuple(f"{kind} {row}/{column}" for kind in ("inertia", "damping") for row in names for column in names)

    @property
    def _generator(self) -> Array:
        """Matrix of the free motion of the coordinates and their rates, shape (2 N, 2 N)."""
        size = len(self.inertia)
        whole = np.zeros((2 * size, 2 * size))
        whole[:size, size:] = np.eye(size)
        whole[size:, :size] = -np.linalg.inv(self.inertia)
        whole[size:, size:] = -np.linalg.solve(self.inertia, self.damping)
        return whole

    @property
    def modal_form(self) -> ModalForm:
        """The free motion, mode by mode."""
        n, size = len(self.components), len(self.inertia)
        poles, shapes = np.linalg.eig(self._generator)
        drive = np.vstack([np.zeros((size, n)), np.linalg.inv(self.inertia)[:, :n]]).astype(np.complex128)
        weights = np.linalg.solve(shapes, drive).astype(np.complex128)
        return ModalForm(poles.astype(np.complex128), shapes[:n].astype(np.complex128), weights)

    @property
    def _motion(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Poles by size, shape (2 N,), and the loads and rates of each, columns, shape (2 N, 2 N)."""
        poles, vectors = np.linalg.eig(self._generator)
        order = np.lexsort((poles.imag, np.round(np.abs(poles), 9)))
        return poles[order].astype(np.complex128), vectors[:, order].astype(np.complex128)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the free motion, shape (2 N,), by size [rad/s]."""
        return self._motion[0]

    @property
    def condensed(self) -> Condensed:
        """The equations of the components without the internal coordinates."""
        return Condensed.of(self.equation, components=len(self.components), poles=self.poles)

    @property
    def zeros(self) -> NDArray[np.complex128]:
        """Motions of the internal coordinates in which no component shows anything [rad/s]."""
        return self.condensed.still

    @property
    def modes(self) -> Modes:
        """Frequency and damping ratio of every oscillation, the slowest first; the shares are left at 1."""
        up = [pole for pole in self.poles if pole.imag > 0]
        modes = (Mode(float(np.abs(pole)) / (2 * np.pi), float(-pole.real / np.abs(pole))) for pole in up)
        return Modes(modes, self._mode_uncertainties)

    def _mode_uncertainties(self) -> Array:
        """Standard uncertainties of the frequencies [Hz] and damping ratios [1] of `modes`, shape (m, 2)."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.mode_covariance), 0.0)).reshape(2, -1).T)

    @property
    def mode_slopes(self) -> Array:
        """Slopes of the frequencies of `modes` [Hz], then of their damping ratios, by `parameters`, (2 modes, 2 N^2).

        A pole s with the shape x, 1 + D s + A s^2 times x being zero, moves by -w (dD s + dA s^2) x with its weight w.
        """
        size = len(self.inertia)
        poles, vectors = self._motion
        up = np.flatnonzero(poles.imag > 0)
        drive = np.vstack([np.zeros((size, size)), np.linalg.inv(self.inertia)])
        weights, s = np.linalg.solve(vectors, drive)[up], poles[up, None]
        product = -(weights[:, :, None] * vectors[:size, up].T[:, None, :]).reshape(up.size, size**2)
        slopes = np.hstack([product * s**2, product * s])
        radius = np.abs(s)
        by_radius = np.real(s.conj() * slopes) / radius
        by_ratio = (s.real / radius * by_radius - slopes.real) / radius
        return np.asarray(np.vstack([by_radius / (2 * np.pi), by_ratio]))

    @property
    def mode_covariance(self) -> Array:
        """Covariance of the frequencies of `modes` [Hz], then of their damping ratios, (2 modes, 2 modes).

        To first order in `total_covariance`: modes that nearly coincide in frequency and damping move farther.
        """
        slopes = self.mode_slopes
        return np.asarray(slopes @ self.total_covariance @ slopes.T)

    def equation(self, s: ArrayLike) -> NDArray[np.complex128]:
        """1 + D s + A s^2 of all coordinates, internal ones too, at s of shape (m,) [rad/s]; shape (m, N, N)."""
        s = np.asarray(s, dtype=np.complex128)[:, None, None]
        return np.asarray(np.eye(len(self.inertia)) + s * self.damping + s**2 * self.inertia)

    def inverse_response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Return F over X at frequencies of shape (m,) [Hz], shape (m, n, n): 1 + D s + A s^2, condensed."""
        n = len(self.components)
        whole = self.equation(2j * np.pi * np.asarray(frequency, dtype=np.float64))
        seen = whole[:, :n, :n]
        if not self.internal:
            return seen
        return np.asarray(seen - whole[:, :n, n:] @ np.linalg.solve(whole[:, n:, n:], whole[:, n:, :n]))

    def response(self, frequency: ArrayLike) -> NDArray[np.complex128]:
        """Balance loads over loads applied at frequencies of shape (m,) [Hz], shape (m, n, n)."""
        n = len(self.components)
        whole = self.equation(2j * np.pi * np.asarray(frequency, dtype=np.float64))
        return np.asarray(np.linalg.inv(whole)[:, :n, :n])

    def balance_load(self, net: Array, *, interval: float, every: int = 1) -> Array:
        """Balance loads under loads that are linear between samples and were held before the first; both (samples, n).

        Parameters
        ----------
        net
            Loads on the moving mass, shape (samples, n) [N, N*m].
        interval
            Time between them [s].
        every
            Of how many samples one is returned: the balance loads are smoother than what they are worked out from.
        """
        poles, shapes, weights = self.modal_form
        change = np.ascontiguousarray(net - net[0])
        felt = np.tile(net[0], (-(-net.shape[0] // every), 1))
        for pole, shape, weight in zip(poles, shapes.T, weights, strict=True):
            if pole.imag < 0:  # its part is the conjugate of that of its twin
                continue
            growth = complex(np.exp(pole * interval))
            late = (np.expm1(pole * interval) - pole * interval) / (pole**2 * interval)
            early = np.expm1(pole * interval) / pole - late
            shown = np.ascontiguousarray((1 if pole.imag == 0 else 2) * shape)
            add_mode(growth, np.array([late, early]), np.ascontiguousarray(weight), shown, change, every, felt)
        return felt

    def force_slopes(self, frequency: Array) -> Iterator[ForceSlopes]:
        """What inertia and damping do to the forces at frequencies of shape (m,) [Hz], one component after another."""
        n, s = len(self.components), 2j * np.pi * np.asarray(frequency, dtype=np.float64)
        whole = self.equation(s)
        coordinates = np.linalg.inv(whole)[:, :, :n]
        for place in range(n):
            rows = parameter_rows(place, components=n, internal=self.internal)
            # an error of an internal equation comes to the force as the internal coordinates do
            carried = np.zeros((s.size, 1 + self.internal), dtype=np.complex128)
            carried[:, 0] = 1.0
            if self.internal:
                inside = whole[:, n:, n:].transpose(0, 2, 1)
                carried[:, 1:] = -np.linalg.solve(inside, whole[:, place, n:, None])[..., 0]
            slopes = np.concatenate(
                [
                    (power[:, None, None] * carried[:, :, None])[..., None] * coordinates[:, None]
                    for power in (s**2, s)
                ],
                axis=1,
            ).reshape(s.size, rows.size, n)
            yield ForceSlopes(slopes, self.covariance[np.ix_(rows, rows)])

    @property
    def quadratic(self) -> tuple[Array, Array]:
        """D [s] and A [s^2] of the components by themselves, shape (n, n) each."""
        n = len(self.components)
        return self.damping[:n, :n], self.inertia[:n, :n]

    @property
    def _rows(self) -> list[int]:
        """Where the components are among all six."""
        return [COMPONENTS.index(name) for name in self.components]

    @property
    def mass_rows(self) -> Array:
        """Rows of the mass matrix that belong to the components, shape (n, 6); zero without a mass."""
        return np.zeros((len(self.components), len(COMPONENTS))) if self.mass is None else self.mass.matrix[self._rows]

    @property
    def moved_by(self) -> NDArray[np.bool_]:
        """Accelerations for which the mass is known, shape (6,): all or none."""
        return np.full(len(COMPONENTS), self.mass is not None)

    @property
    def delays(self) -> Array:
        """Times by which the loads lag the acceleration of the ground end, shape (n,) [s]: zero."""
        return np.zeros(len(self.components))

    @property
    def row_covariance(self) -> Array:
        """Covariance of a row of A, of D and of the mass matrix, one behind the other, shape (n, 2n + 6, 2n + 6)."""
        n, size = len(self.components), len(self.inertia)
        element = np.arange(2 * size * size).reshape(2, size, size)
        covariance = np.zeros((n, 2 * n + 6, 2 * n + 6))
        slopes = None if self.mass is None else np.array(mass_slopes(self.mass))
        for place, row in enumerate(self._rows):
            own = element[:, place, :n].ravel()
            covariance[place, : 2 * n, : 2 * n] = self.covariance[np.ix_(own, own)]
            if self.mass is not None and slopes is not None:
                covariance[place, 2 * n :, 2 * n :] = slopes[:, row].T @ self.mass.covariance @ slopes[:, row]
        return covariance

    def weight(self, name: str, *, pitch: Array, roll: Array, gravity: float) -> Array:
        """Weight of the common moving mass along a component [N, N*m], shape (n,); nothing where no mass is known."""
        if self.mass is None:
            return np.zeros_like(pitch)
        return self.mass.weight(pitch, roll, gravity=gravity)[:, COMPONENTS.index(name)]

    def decoupled(self, component: str, *, noise: Array) -> DecoupledChannel:
        """How one component is decoupled from the others, with a noise of the readings of this covariance, (n, n)."""
        return DecoupledChannel.of(component, self.components.index(component), self.condensed, noise=noise)

    def own_response(self, component: str) -> EquivalentModel:
        """One component's reading under its own force alone: every mode with its share of a steady load.

        The part of a residue that goes with the rate of the load, which damping that couples the modes gives, is left
        out.

        Raises
        ------
        FitError
            A mode does not oscillate.
        """
        place = self.components.index(component)
        poles, shapes, weights = self.modal_form
        up = poles.imag > 0
        if 2 * np.count_nonzero(up) != poles.size:
            raise FitError("a mode is damped so strongly that it does not oscillate: no method for one component fits")
        residues = shapes[place, up] * weights[up, place]
        order = np.argsort(np.abs(poles[up]))
        modes = [
            Mode(float(abs(pole)) / (2 * np.pi), float(-pole.real / abs(pole)), float(share))
            for pole, share in zip(poles[up][order], (-2 * np.real(residues / poles[up]))[order], strict=True)
        ]
        return EquivalentModel(component, modes[0], tuple(modes[1:]))
