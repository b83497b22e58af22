"""Build the eigenstrains and temperatures of a body from the declarations of a case."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pdpetsc.arrays import Float, LocalIndex
from pdpetsc.bond_based import BondMaterial
from pdpetsc.errors import CaseError, case_errors
from pdpetsc.material import Material
from pdpetsc.material.thermal import Thermal
from pdpetsc.problem.body import Body
from pdpetsc.problem.expansion import PrescribedTemperature, StressFree, TemperatureField
from pdpetsc.terms.conditions import Applied


def prescribed_temperature(body: Body, applied: Applied, start: Float) -> PrescribedTemperature:
    """Build the prescribed temperature, ``start`` (n_owned,) for other particles (collective).

    Raises
    ------
    CaseError
        Two conditions prescribe different temperatures of the same particle.
    """
    found = PrescribedTemperature(body.cloud, start)
    for name, condition, mask in applied.temperatures:
        found.prescribe(condition, mask, name)
    with case_errors():
        for t in applied.times if found.given.shared else ():
            found.at(t)
    return found


def reference_temperature(thermals: Sequence[Thermal | None], material_of: LocalIndex) -> Float:
    """Return the stress-free temperature of the material of each own particle (n_owned,), 0 without one."""
    of = np.array([0.0 if one is None else float(one.reference) for one in thermals])
    return np.asarray(of[material_of])


def stress_free(
    body: Body, applied: Applied, thermals: Sequence[Thermal | None], material_of: LocalIndex,
    materials: Sequence[Material | BondMaterial], field: TemperatureField | None = None,
) -> StressFree:  # fmt: skip
    """Build the stress-free deformation of a body, with prescribed temperature or ``field`` (collective).

    Raises
    ------
    CaseError
        A material expands and has no temperature, or a temperature acts on no such material. Two conditions prescribe
        different temperatures of one particle. A function fails at the beginning or the end of the load.
    """
    thermal = any(one is not None for one in thermals)
    if field is None and applied.heat:
        raise CaseError(f"{applied.heat[0][0]} needs heat conduction; give the case heat=pd.HeatConduction(...).")
    if field is None and bool(applied.temperatures) != thermal:
        raise CaseError(
            "A Thermal material needs a temperature; give the case a Temperature condition."
            if thermal
            else f"{applied.temperatures[0][0]} acts on no material that knows temperature; wrap one in Thermal."
        )
    if field is None and thermal:
        field = prescribed_temperature(body, applied, reference_temperature(thermals, material_of))
    strains = [(np.flatnonzero(mask).astype(np.int32), condition) for _, condition, mask in applied.eigenstrains]
    across = [
        one.elastic(body.dim).nu if isinstance(one, BondMaterial) and body.dim == 2 and one.plane == "strain" else 0.0
        for one in materials
    ]
    made = StressFree(body.cloud, body.families, thermals, material_of, field, strains, np.array(across)[material_of])
    with case_errors():
        for t in (0.0, 1.0):
            _ = made.at(t).strain, made.at(t).factor
    return made
