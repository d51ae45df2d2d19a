"""Writes the model fields of the person. They differ between worlds, because each world has its own person."""

from collections.abc import Collection
from functools import lru_cache

import numpy as np
from mujoco.batch import Batch

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.models import compliance, human
from avrgym.models.body_names import Side
from avrgym.models.human import ARM_BODIES, People, Person
from avrgym.models.scene import SceneConfig
from avrgym.simulation.model_addresses import find_actuator_ids


class PersonModelFields:
    """Writes body sizes, masses, torque limits and damping of each world's person into the models."""

    def __init__(self, batch: Batch, scene: SceneConfig, moving: bool) -> None:
        model = batch.get_model(0)
        self._posture, self._moving = scene.posture, moving
        self._batch, self._contact_types, self._has_absent_arms = batch, model.geom_contype.copy(), False
        self._body_mass_kg = scene.body_mass_kg
        self._bodies = {name: model.body(human.PERSON_NAME_PREFIX + name).id for name in human.BODIES}
        self._geoms = {name: model.geom(human.PERSON_NAME_PREFIX + name).id for name in human.GEOMS}
        self._sites = {name: model.site(human.PERSON_NAME_PREFIX + name).id for name in human.SITE_BODIES}
        self._body_pos, self._body_quat = batch.expand("body_pos"), batch.expand("body_quat")
        self._geom_pos, self.geom_size = batch.expand("geom_pos"), batch.expand("geom_size")
        self._site_pos = batch.expand("site_pos")
        self._ids = np.array([*self._bodies.values()])
        self._inverse_mass = batch.expand("body_invweight0")
        self._mass_share = human.compute_body_mass_fractions()
        self._mass = batch.expand("body_mass")
        if moving:
            self._inertia = {name: batch.expand(name) for name in INERTIAL_FIELDS}
            self._actuators = find_actuator_ids(
                model, [human.PERSON_NAME_PREFIX + name for name in human.JOINTS]
            )
            self._force_range = batch.expand("actuator_forcerange")
            self._damping = batch.expand("dof_damping")
            self._dofs = model.jnt_dofadr[
                [model.joint(human.PERSON_NAME_PREFIX + name).id for name in human.JOINTS]
            ]

    def write(self, ids: IntArray, people: People) -> None:
        """Write the model fields of ``people`` (n,) into the models of worlds ``ids`` (n,)."""
        layout = human.compute_people_layout(people, self._posture)
        for name, body in self._bodies.items():
            self._body_pos[ids, body] = layout.body_pos[name]
        for name, geom in self._geoms.items():
            self._geom_pos[ids, geom] = layout.geom_pos[name]
            self.geom_size[ids, geom] = layout.geom_size[name]
        for name, site in self._sites.items():
            self._site_pos[ids, site] = layout.site_pos[name]
        if self._moving:
            self._write_dynamics(ids, people, np.asarray(layout.dimensions.mass_kg))
        else:
            rotations = human.compute_body_rotations(people.joint_angles_rad, self._posture)
            for name, body in self._bodies.items():
                self._body_quat[ids, body] = rotations[name]
            kg = np.asarray(layout.dimensions.mass_kg)
            if self._body_mass_kg is not None:
                kg = np.full(len(ids), self._body_mass_kg)
            self._mass[np.ix_(ids, self._ids)] = kg[:, None] * self._mass_share

    def set_absent_arms(self, arms: Collection[Side]) -> BoolArray:
        """Remove the contacts of amputated arms in all worlds. Returns the mask (G,) of their geoms in ``GEOMS``."""
        names = [name for arm in arms for name in ARM_BODIES[arm]]
        absent = np.isin([*self._geoms], names)
        if absent.any() or self._has_absent_arms:
            geoms = [*self._geoms.values()]
            self._batch.expand("geom_contype")[:, geoms] = np.where(absent, 0, self._contact_types[geoms])
        self._has_absent_arms = bool(absent.any())
        return absent

    def make_contacts_compliant(self, ids: IntArray) -> None:
        """Set the compliance of contacts with people in worlds ``ids`` (n,). Call this method after ``set_const``."""
        self._inverse_mass[ids[:, None], self._ids, 0] += compliance.PERSON_INVERSE_MASS_PER_KG

    def _write_dynamics(self, ids: IntArray, people: People, kg: FloatArray) -> None:
        for row, world in enumerate(ids):
            person = people.get_person(row)
            inertia = _inertia(
                person.sex, person.torso_height_m, person.arm_scale, person.stature_m, person.bmi_kg_m2
            )
            for name, field in self._inertia.items():
                field[world, self._ids] = inertia[name]
            if self._body_mass_kg is not None:
                for name in ("body_mass", "body_inertia"):
                    self._inertia[name][world, self._ids] *= self._body_mass_kg / kg[row]
        torque = compliance.compute_person_torque_limits_n_m(
            people.strength_share.reshape(len(ids), -1) * human.JOINT_TORQUE_LIMITS_N_M, people.tremor_rad
        )
        limits = np.stack([-torque, torque], axis=-1) * people.torque_fraction
        self._force_range[ids[:, None], self._actuators] = limits
        self._damping[ids[:, None], self._dofs] = people.damping_n_m_s


INERTIAL_FIELDS = ("body_mass", "body_inertia", "body_ipos", "body_iquat")
"""Names of MuJoCo's model fields for mass, inertia and centre of mass of bodies."""


@lru_cache(maxsize=1024)
def _inertia(
    sex: human.Sex, torso_height_m: float, arm_scale: float, stature_m: float | None, bmi_kg_m2: float | None
) -> dict[str, FloatArray]:
    """Returns the inertial model fields of a person's bodies, in the order of ``human.BODIES``."""
    person = Person(sex, torso_height_m, arm_scale=arm_scale, stature_m=stature_m, bmi_kg_m2=bmi_kg_m2)
    model = human.compile_person_model(person, moving=True)
    bodies = [model.body(human.PERSON_NAME_PREFIX + name).id for name in human.BODIES]
    return {name: getattr(model, name)[bodies] for name in INERTIAL_FIELDS}
