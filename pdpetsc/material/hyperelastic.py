"""Hyperelastic materials from a strain energy written in one line, and base of named laws."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from pdpetsc.arrays import Float, GlobalIndex
from pdpetsc.declared import numbers_from, real_numbers, shown
from pdpetsc.errors import CaseError
from pdpetsc.material.base import LARGEST_MODULUS, HistoryKernels, Material, isotropic_moduli
from pdpetsc.material.directed import DirectedMaterial, isotropic_mean
from pdpetsc.material.symmetric import WEIGHT, matrix, moduli_of_body

if TYPE_CHECKING:
    from pdpetsc.material.energy import Energy
    from pdpetsc.material.energy_loops import Loops

# A unit vector, or a function that returns unit vectors for positions.
Direction: TypeAlias = Sequence[float] | Callable[[Float], Float]
# Tolerance of the length of a direction, and of the stress at F = I over the largest modulus.
NEARLY_ONE, NEARLY_ZERO = 1e-6, 1e-9
# Volumetric part of named laws.
VOLUMETRIC = "kappa/4 * (J**2 - 1 - 2*log(J))"


class EnergyMaterial(DirectedMaterial):
    """A material with a strain energy as text; stress, tangent and hidden stretches derive from it.

    In plane stress the out-of-plane stretch, and in a bar the lateral stretch, follows from ``d psi / d b = 0`` at
    every point. The tangent is condensed accordingly.
    """

    @abstractmethod
    def declared_energy(self) -> tuple[str, Mapping[str, float]]:
        """Return the text of the energy and its constants."""

    def directions(self) -> tuple[Direction, ...]:
        """Return the declared fibre directions, in the order of the fields."""
        given = (getattr(self, name, None) for name in ("fibre", "second_fibre"))
        return tuple(direction for direction in given if direction is not None)

    def __post_init__(self) -> None:
        super().__post_init__()
        name = type(self).__name__
        for constant, value in self.declared_energy()[1].items():
            number = real_numbers(value)
            if number is None or number.ndim or not np.abs(number) <= LARGEST_MODULUS or isinstance(value, bool | str):
                raise CaseError(f"{name} takes a number as constant {constant}, not {shown(value)}.")
        given = self.directions()
        if self._energy.n_fibres > len(given):
            which = "fibre" if not given else "second_fibre"
            raise CaseError(f"The energy of {name} reads a direction that is not given; give {which}=.")
        if self._energy.n_fibres < len(given):
            raise CaseError(f"The energy of {name} does not read one of its {len(given)} fibre directions.")
        for field in ("fibre", "second_fibre"):
            direction = getattr(self, field, None)
            if direction is not None and not callable(direction):
                # Not an array, so that materials can be compared.
                object.__setattr__(self, field, tuple(_unit(direction, name).tolist()))
        try:
            self._refuse_bad_start()
        except RecursionError:
            raise CaseError(f"The energy of {name} is nested too deeply to be differentiated.") from None

    @property
    def _energy(self) -> Energy:
        # Imported here because SymPy is slow to import.
        from pdpetsc.material.energy import parse

        text, constants = self.declared_energy()
        return parse(text, tuple(constants))

    def _loops(self, dim: int) -> Loops:
        from pdpetsc.material.energy_loops import loops_of

        return loops_of(self._energy, self.kind(dim))

    def history_kernels(self, dim: int) -> HistoryKernels:
        """Return the compiled loops for dimension ``dim``."""
        return self._loops(dim).kernels

    def constants(self, dim: int) -> Float:
        """Return the constants in the declared order, and the lateral ratio of the linear law."""
        lam, mu = isotropic_mean(self._solid())
        ratio = {"solid": 0.0, "strain": 0.0, "stress": -lam / (lam + 2.0 * mu), "bar": -0.5 * lam / (lam + mu)}
        return np.array([*self._values(), ratio[self.kind(dim)]])

    def _values(self) -> tuple[float, ...]:
        return tuple(float(value) for value in self.declared_energy()[1].values())

    def history_at(self, dim: int, x: Float) -> Float:
        """Return the fibre directions of points of particles at ``x``, one after the other (n, n_fibres dim)."""
        columns = [self._direction_at(direction, dim, x) for direction in self.directions()]
        return np.ascontiguousarray(np.concatenate(columns, axis=1)) if columns else np.empty((len(x), 0))

    def history_in_space(self, x: Float) -> Float:
        """Return the fibre directions of a plane body as vectors in space (n, 3 n_fibres)."""
        plane = self.history_at(2, x).reshape(len(x), len(self.directions()), 2)
        return np.ascontiguousarray(np.pad(plane, ((0, 0), (0, 0), (0, 1))).reshape(len(x), -1))

    def _direction_at(self, direction: Direction, dim: int, x: Float) -> Float:
        name = type(self).__name__
        if not callable(direction):
            unit = _unit(direction, name)
            if len(unit) != dim:
                raise CaseError(f"The fibres of {name} have {len(unit)} components, but the body has {dim} dimensions.")
            return np.tile(unit, (len(x), 1))
        if len(x) == 0:  # the function may not support empty arrays
            return np.empty((0, dim))
        values = numbers_from(f"fibre direction of {name}", direction, x)
        if values.shape != x.shape:
            raise CaseError(
                f"The fibre direction of {name} must return one vector per particle, {x.shape}, not {values.shape}."
            )
        length = np.linalg.norm(values, axis=1)
        bad = np.flatnonzero(~(np.abs(length - 1.0) <= NEARLY_ONE))
        if len(bad):
            raise CaseError(
                f"The fibre direction of {name} is {values[bad[0]]} at {x[bad[0]]}, of length {length[bad[0]]:g}; "
                f"it must be a unit vector."
            )
        return np.asarray(values / length[:, None])

    def uniform(self) -> Material:
        """Return the material with all fibres along the first axis."""
        given = {name: _along_first for name in ("fibre", "second_fibre") if getattr(self, name, None) is not None}
        declared: Any = self
        replaced: Material = dataclasses.replace(declared, **given)
        return replaced

    def _across(self, F: Float, select: GlobalIndex, directions: Float) -> Float:
        dim = F.shape[-1]
        result = np.empty(len(select))
        self._loops(dim).across(np.ascontiguousarray(F), select, self.constants(dim), directions, result)
        return result

    def defined(self, F: Float, select: GlobalIndex, history: Float) -> bool:
        """Return True if the hidden stretch exists at all points ``select``, within the bounds of the energy."""
        inside = self._loops(F.shape[-1]).inside
        if inside is not None:
            shares = np.empty(len(select))
            inside(np.ascontiguousarray(F), select, self.constants(F.shape[-1]), history, shares)
            return bool(np.all(shares > 0.0))
        if self.kind(F.shape[-1]) in ("solid", "strain"):
            return True
        return bool(np.isfinite(self._across(F, select, history)).all())

    def hidden_stretch(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``b`` in plane stress, ``b^2`` in a bar, 1 in plane strain and solids (n,) [-]."""
        if self.kind(F.shape[-1]) in ("solid", "strain"):
            return np.ones(len(F))
        return self._across(F, np.arange(len(F)), history)

    def out_of_plane_stress(self, F: Float, history: Float, dt: float = 0.0) -> Float:
        """Return ``P_zz = d psi / d F_zz`` (n,) [stress] in plane strain."""
        return self._across(F, np.arange(len(F)), history)

    def moduli(self, dim: int) -> Float:
        """Return ``dP/dF`` at F = I, or its isotropic mean if directions are functions of position."""
        if any(map(callable, self.directions())):
            return self._mean(dim)
        return moduli_of_body(self._undeformed(self._axes())[1], dim, self.plane)

    def _solid(self) -> Float:
        """Return the moduli with all fibres along the first axis."""
        return self._undeformed([np.eye(3)[0]] * len(self.directions()))[1]

    def _axes(self) -> list[Float]:
        """Return the fibre directions in space (3,) each, the first axis if one is a function of position."""
        given = self.directions()
        if any(map(callable, given)):
            return [np.eye(3)[0]] * len(given)
        return [np.append(_unit(one, type(self).__name__), np.zeros(3))[:3] for one in given]

    def _undeformed(self, axes: Sequence[Float]) -> tuple[Float, Float]:
        """Return stress (3, 3) and moduli (3, 3, 3, 3) of a solid with fibres along axes at F = I [stress]."""
        return _undeformed(self._energy, self._values(), tuple(map(tuple, axes)))

    def young_modulus(self) -> float:
        """Return ``mu (3 lambda + 2 mu) / (lambda + mu)`` of the law at small strain."""
        moduli = self._solid()
        lam, mu = isotropic_mean(moduli)
        if np.abs(moduli - isotropic_moduli(lam, mu, 3)).max() > NEARLY_ZERO * np.abs(moduli).max():
            return super().young_modulus()
        return mu * (3.0 * lam + 2.0 * mu) / (lam + mu)

    def _refuse_bad_start(self) -> None:
        """Raise CaseError if the undeformed state has a stress or is not stable."""
        name = type(self).__name__
        stress, moduli = self._undeformed(self._axes())
        size = float(np.abs(moduli).max())
        if not (np.isfinite(size) and np.isfinite(stress).all()):
            raise CaseError(f"The energy of {name} has no finite stress and tangent at F = I.")
        if not _starts_with_a_value(self._energy, self._values()):
            raise CaseError(f"The energy of {name} is no finite number at F = I.")
        worst = stress.flat[int(np.abs(stress).argmax())]
        if abs(worst) > NEARLY_ZERO * size or size == 0.0:
            raise CaseError(
                f"The energy of {name} has the stress {worst:.6g} at F = I, where it must have none, with moduli of "
                f"{size:.6g}."
            )
        least = np.linalg.eigvalsh(_voigt(moduli)).min()
        if not least > NEARLY_ZERO * NEARLY_ONE * size:
            raise CaseError(
                f"The energy of {name} is not stable at F = I: the least eigenvalue of its small-strain stiffness is "
                f"{least:.6g}, not positive."
            )


def _along_first(x: Float) -> Float:
    return np.tile(np.eye(x.shape[1])[0], (len(x), 1))


def _unit(direction: Direction, name: str) -> Float:
    """Return a given direction as a unit vector."""
    values = real_numbers(direction)
    length = 0.0 if values is None or values.ndim != 1 or not 1 <= len(values) <= 3 else float(np.linalg.norm(values))
    if values is None or not abs(length - 1.0) <= NEARLY_ONE:
        raise CaseError(f"{name} takes a unit vector or a function as fibre direction, not {shown(direction)}.")
    return np.asarray(values / length)


@lru_cache
def _starts_with_a_value(energy: Energy, constants: tuple[float, ...]) -> bool:
    """Return True if the energy, 0 at F = I, is defined there: no logarithm of a negative number."""
    import sympy

    from pdpetsc.material.energy import UNDEFORMED

    numbers = dict(zip(energy.constants, map(sympy.Float, constants), strict=True))
    arguments = (one.args[0] for one in energy.expression.atoms(sympy.log))
    return all(bool(one.xreplace(UNDEFORMED).xreplace(numbers) > 0) for one in arguments)


@lru_cache
def _undeformed(energy: Energy, constants: tuple[float, ...], axes: tuple[tuple[float, ...], ...]) -> tuple[Float, Any]:
    """Return stress (3, 3) and tangent (3, 3, 3, 3) of a solid at F = I."""
    import sympy

    from pdpetsc.material.energy import SYMBOLS, UNDEFORMED, derivative, overflows
    from pdpetsc.material.energy_loops import invariant_scalars

    numbers = {symbol: sympy.Float(value, 17) for symbol, value in zip(energy.constants, constants, strict=True)}

    if overflows(energy.expression, {**UNDEFORMED, **numbers}):
        return np.full((3, 3), np.nan), np.full((3, 3, 3, 3), np.nan)

    def value(expression: Any) -> float:
        try:
            number = complex(sympy.sympify(expression).xreplace({**UNDEFORMED, **numbers}).evalf())
        except (TypeError, ValueError, ArithmeticError):
            return float("nan")
        return number.real if number.imag == 0.0 else float("nan")

    one = np.eye(3)
    if energy.of_stretches:
        l1, l2 = SYMBOLS["l1"], SYMBOLS["l2"]
        first = derivative(energy.expression, l1)
        stress, lam, whole = value(first), value(derivative(first, l2)), value(derivative(first, l1))
        # For the shear moduli (dP/dF)_abab and (dP/dF)_abba use half the sum; half the difference is half the stress.
        moduli = isotropic_moduli(lam, 0.5 * (whole - lam), 3)
        return stress * one, moduli
    scalars = invariant_scalars(energy, "solid")
    g = {name: value(expression) for name, expression in scalars.g.items()}
    h = {pair: value(expression) for pair, expression in scalars.h.items()}
    tensors = {"I1": one, "I2": 2.0 * one, "J": one}
    for number, axis in enumerate(axes):
        dyad = np.outer(axis, axis)
        tensors |= {f"I{4 + 2 * number}": dyad, f"I{5 + 2 * number}": 2.0 * dyad}
    P = sum((g[name] * tensors[name] for name in g), np.zeros((3, 3)))
    A = sum((h[m, n] * np.multiply.outer(tensors[m], tensors[n]) for m, n in h), np.zeros((3, 3, 3, 3)))
    same, turned = np.einsum("ik,mn->imkn", one, one), np.einsum("in,km->imkn", one, one)
    A = A + g.get("I1", 0.0) * same + g.get("I2", 0.0) * (same - turned) - g.get("J", 0.0) * turned
    for number, axis in enumerate(axes):
        dyad = np.outer(axis, axis)
        A = A + g.get(f"I{4 + 2 * number}", 0.0) * np.einsum("ik,mn->imkn", one, dyad)
        five = [np.einsum(index, one, dyad) for index in ("ik,mn->imkn", "mn,ik->imkn", "km,in->imkn", "in,km->imkn")]
        A = A + g.get(f"I{5 + 2 * number}", 0.0) * (3.0 * five[0] + five[1] + five[2] + five[3])
    return P, A


def _voigt(moduli: Float) -> Float:
    """Return the stiffness of the strains ``11, 22, 33, sqrt(2) 23, ...`` (6, 6)."""
    both = moduli + moduli.transpose(1, 0, 2, 3)
    return np.asarray(matrix(0.25 * (both + both.transpose(0, 1, 3, 2))) * np.outer(WEIGHT, WEIGHT))


@dataclass(frozen=True, init=False)
class Hyperelastic(EnergyMaterial):
    """A material from its strain energy density, written in one line.

    The text has numbers, constants, ``+ - * / **``, ``sqrt, exp, log, sinh, cosh, tanh, atan``, the positive part
    ``pos`` and one set of variables, of the right stretch ``C = F^T F`` of the three-dimensional body:

    - invariants ``I1 = tr C``, ``I2``, ``I3 = det C``, ``J = det F``; of fibres ``I4 = a . C a`` and ``I5 = a . C^2 a``
      with ``a`` the direction ``fibre``, ``I6`` and ``I7`` with ``second_fibre``; with ``bar``, as ``I1bar``, those of
      ``J^(-1/3) F``;
    - or principal stretches ``l1, l2, l3``, ``l1bar, ...``, ``J``, in which it must be symmetric.

    Stress and tangent are derived from it exactly and compiled once; the machine code is kept on disk. The value at F =
    I is subtracted. There is no stress beyond a bound, at which the argument of a logarithm or a divisor changes its
    sign: a step that leads there is cut back.

    Parameters
    ----------
    energy : str
        The energy density [stress].
    plane : {"strain", "stress"}
        Plane strain or plane stress of a two-dimensional body.
    fibre, second_fibre : sequence of float or callable, optional
        Unit vectors (dim,) in the undeformed body, or functions of positions (n, dim) that return unit vectors (n,
        dim).
    values : mapping of str to float, optional
        Constants by name [stress, or none].
    density : float, optional
        Mass per reference volume [mass / volume].
    **constants : float
        Constants as keyword arguments.

    Raises
    ------
    CaseError
        The energy is no such expression, or has a stress or no positive definite stiffness at F = I. A constant is
        missing, unused or no number, or a direction is no unit vector.

    References
    ----------
    Holzapfel2000, sections 6.2 and 6.5.

    Examples
    --------
    >>> import pdpetsc as pd
    >>> rubber = pd.Hyperelastic("mu/2 * (I1 - 3 - 2*log(J)) + lam/2 * log(J)**2", mu=0.4, lam=1.0)
    >>> ply = pd.Hyperelastic(
    ...     "mu/2 * (I1bar - 3) + kappa/2 * (J - 1)**2 + k/2 * (I4 - 1)**2", fibre=(0.6, 0.8), mu=1.0, kappa=5.0, k=3.0
    ... )
    """

    energy: str
    plane: Literal["strain", "stress"]
    fibre: Direction | None
    second_fibre: Direction | None
    values: Mapping[str, Any]

    def __init__(
        self,
        energy: str,
        plane: Literal["strain", "stress"] = "strain",
        fibre: Direction | None = None,
        second_fibre: Direction | None = None,
        values: Mapping[str, float] | None = None,
        density: float | None = None,
        **constants: float,
    ) -> None:
        given = {} if values is None else values
        together = {**given, **constants} if isinstance(given, Mapping) else given
        fields: dict[str, Any] = {"energy": energy, "plane": plane, "fibre": fibre, "second_fibre": second_fibre}
        fields |= {"values": together, "density": density}
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        self.__post_init__()

    def declared_energy(self) -> tuple[str, Mapping[str, float]]:
        """Return the text and the constants."""
        return self.energy, self.values
