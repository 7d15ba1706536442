"""Records through which the loop finds the data of a machine in memory."""

from collections.abc import Mapping

import numpy as np

from ...drive.kernel import process_data

# The coupling of a drive to the physics. One record per drive.
COUPLING = np.dtype(
    [
        ("qpos", "i8"),  # address of the joint coordinate
        ("dof", "i8"),  # address of the joint's degree of freedom
        ("ctrl", "i8"),  # number of the actuator
        ("velocity_steps", "i8"),  # physics steps per velocity cycle
        ("gear", "f8"),  # rad of motor shaft per m (slide) or rad (hinge) of the joint
        ("friction", "f8"),  # Coulomb friction of the joint with the brake released (N or Nm)
        ("brake_friction", "f8"),  # added by the engaged brake; 0 = there is none
        ("switch_from", "f8", (3,)),  # (m or rad); from > to: there is no such switch
        ("switch_to", "f8", (3,)),
        ("switch_hysteresis", "f8", (3,)),
        ("switch_active", "u1", (3,)),
        ("noise", "f8"),  # standard deviation of the measured position (m or rad); 0 = none
        ("noise_state", "u8"),  # of its generator
        ("torque_peak", "f8"),  # of the agent's step, with its sign (Nm)
        ("error_peak", "f8"),  # of the following error (position units)
    ],
    align=True,
)

# The addresses of the data of a machine. One record per machine.
WORLD = np.dtype(
    [
        ("mj_model", "i8"),  # address of MjModel
        ("mj_data", "i8"),  # address of MjData (a record has a `data` of its own)
        ("qpos", "i8"),  # addresses of the coordinates after the last run, for the tasks
        ("qvel", "i8"),
        ("mj_qpos", "i8"),  # addresses of arrays of MjData
        ("mj_qvel", "i8"),
        ("ctrl", "i8"),
        ("inertia", "i8"),  # M
        ("passive", "i8"),  # qfrc_passive
        ("acceleration", "i8"),  # qacc
        ("smooth_acceleration", "i8"),  # qacc_smooth
        ("stiffness", "i8"),  # MjModel.jnt_stiffness
        ("damping", "i8"),  # MjModel.dof_damping
        ("directions", "i8"),  # of the friction forces, two rows of nv numbers per drive
        ("responses", "i8"),  # accelerations by these forces, the same shape
        ("response_row", "i8"),  # bytes from one of these rows to the next
        ("nq", "i8"),  # lengths of the arrays
        ("nv", "i8"),
        ("nu", "i8"),
        ("inertias", "i8"),
        ("guides", "i8"),
        ("joints", "i8"),
        ("status", "i8"),  # `Status`
        ("axes", "i8"),  # addresses of the records of the drives, and their number
        ("couplings", "i8"),
        ("mechanics", "i8"),
        ("pdos", "i8"),
        ("drives", "i8"),
        ("tick", "i8"),  # physics steps since the reset
        ("delay", "i8"),  # physics steps by which an RPDO image is late
        ("latches", "i8"),  # address of one byte per row: latch its RPDO image?; 0: latch all
        ("latches_from", "i8"),  # tick of the first of these rows
        ("latches_count", "i8"),
        ("pace", "i8"),  # physics steps between two readings of the clock; 0: not yet known
        ("probes", "i8"),  # address of the PROBE records; 0: none
        ("timestep", "f8"),  # s
        ("step_ticks", "i8"),  # physics steps since the last RPDO image
        ("limited_ticks", "i8"),  # those of them with an internal limit active in a drive
        # addresses for a machine that shares MjModel and MjData with others
        ("state", "i8"),  # its state while another machine is there; 0: nothing is shared
        ("kept", "i8"),  # its values of the variable fields of MjModel
        ("fields", "i8"),  # where these fields are
        ("field_count", "i8"),
        ("resident", "i8"),  # a number: the address of the machine that is there now
        # addresses of MjModel.opt.timestep, .integrator and .enableflags
        ("option_timestep", "i8"),
        ("option_integrator", "i8"),
        ("option_enableflags", "i8"),
        ("act_callbacks", "i8"),  # 1: callbacks of MuJoCo compute the laws of actuators
        ("rne_flag", "i8"),  # address of MjData.flg_rnepost
    ],
    align=True,
)

# A machine whose physics is one of many in single precision on a device (`worlds`). A task reads it
# as a WORLD. The first names differ, so that Numba does not use the code compiled for a WORLD.
SINGLE = np.dtype(
    [
        ("present", "i8"),  # address of a number that is 0 while the machine is left out
        ("arrived", "i8"),  # 1: the physics has not yet taken over a state that was sent
        *WORLD.descr[2:],  # there are no MjModel and MjData
        ("moves", "i8"),  # 1: it takes part in this physics step, and its physics is sound
        ("grips", "i8"),  # 1: a joint has friction in this physics step
        ("kept_warmstart", "i8"),  # addresses of its own state, besides `qpos` and `qvel`
        ("kept_ctrl", "i8"),
        ("warmstart", "i8"),  # qacc_warmstart
        ("ticks", "i8"),  # physics steps in a step of the agent
        ("latch_at", "i8"),  # the one at which the RPDO image is latched; -1: none
        ("rpdo", "i8"),  # addresses of the images, and their sizes; 0 bytes: no image
        ("rpdo_bytes", "i8"),
        ("tpdo", "i8"),
        ("tpdo_bytes", "i8"),
        ("rpdo_record", "i8"),  # addresses of the images as aligned records for the task, of
        ("rpdo_moves", "i8"),  # the MOVE records between both, and their number
        ("rpdo_move_count", "i8"),
        ("tpdo_record", "i8"),
        ("tpdo_moves", "i8"),
        ("tpdo_move_count", "i8"),
    ],
    align=True,
)

# Bytes to be copied from a place of one record to a place of another.
MOVE = np.dtype([("source", "i8"), ("target", "i8"), ("bytes", "i8")])

# Addresses and numbers of the PDOs of a drive.
PDOS = np.dtype([("rpdos", "i8"), ("rpdo_count", "i8"), ("tpdos", "i8"), ("tpdo_count", "i8")])

# A field of MjModel that differs between machines that share it.
FIELD = np.dtype([("address", "i8"), ("length", "i8")])


def mapped(places: Mapping[int, int]) -> np.ndarray:
    """Return a PDO with bytes at the given places of a drive's record.

    Raises ValueError for more places than a PDO can have.
    """
    if len(places) > process_data.ENTRIES:
        raise ValueError(f"{len(places)} columns, at most {process_data.ENTRIES} are possible")
    pdo = process_data.make(1)
    pdo["valid"], pdo["count"], pdo["width"] = 1, len(places), sum(places.values())
    pdo["offset"][0, : len(places)] = [*places]
    pdo["length"][0, : len(places)] = pdo["held"][0, : len(places)] = [*places.values()]
    return pdo
