"""Logs of our own node, told by meaning."""

import binascii
import gzip
import random
import struct

import can
import pytest

from servogym.drive.canopen.decode import Decoder
from servogym.drive.canopen.frame import Frame, parse
from servogym.drive.canopen.node import Node
from servogym.drive.drive import Drive
from servogym.drive.wire.bus import to_message
from servogym.training import cli

NAME = "servogym generic CiA 402 drive"  # 1008h


def tell(*frames, decoder=None):
    decoder = decoder or Decoder()
    return [decoder.decode(parse(frame)) for frame in frames]


class Session:
    """A master and one node; every frame of both is kept."""

    def __init__(self):
        self.drive = Drive(node_id=1)
        self.node = Node(self.drive)
        self.time = 0
        self.frames = []
        self.wait()

    def wait(self, cycles=1):
        for _ in range(cycles):
            self.time += 500
            self.drive.cycle(0.0)
            self.frames += [(self.time, frame) for frame in self.node.poll(self.time)]

    def send(self, *frames):
        for frame in frames:
            frame = parse(frame) if isinstance(frame, str) else frame
            self.frames.append((self.time, frame))
            self.node.receive(frame, self.time)
            self.wait()

    def write(self, index, subindex, size, value):
        command = {1: 0x2F, 2: 0x2B, 4: 0x23}[size]
        data = (value & (1 << 8 * size) - 1).to_bytes(4, "little")
        self.send(Frame(0x601, struct.pack("<BHB", command, index, subindex) + data))

    def map_tpdo1(self, cob_id=0x40000181):
        """Statusword, mode and actual position into TPDO1, with the standard's procedure."""
        self.write(0x1800, 1, 4, 0xC0000181)
        self.write(0x1A00, 0, 1, 0)
        for n, entry in enumerate((0x60410010, 0x60610008, 0x60640020), 1):
            self.write(0x1A00, n, 4, entry)
        self.write(0x1A00, 0, 1, 3)
        self.write(0x1800, 1, 4, cob_id)

    def told(self, decoder=None):
        decoder = decoder or Decoder()
        return [decoder.decode(frame) for _, frame in self.frames]


def test_a_session_is_told_from_boot_up_to_fault():
    session = Session()
    session.map_tpdo1()
    session.write(0x6060, 0, 1, 1)
    session.send("000#0101", "201#0600", "201#0700", "201#0F00")
    session.wait(4)
    session.drive.inject("encoder_loss")
    session.wait(4)
    told = session.told()
    assert told[0] == "boot-up[1]"
    assert told[1] == "SDO[1] write tpdo1_cob_id (1800h:01) = C0000181h"
    assert "SDO[1] write tpdo1_mapping_1 (1A00h:01) = 60410010h statusword" in told
    assert "SDO[1] write modes_of_operation (6060h:00) = 1 PROFILE_POSITION" in told
    assert "NMT start node 1" in told
    assert "RPDO1[1] controlword=000Fh ENABLE_OPERATION" in told
    enabled = [line for line in told if line.startswith("TPDO1[1] statusword=")
               and "OPERATION_ENABLED" in line]
    assert enabled[-1].endswith(
        "modes_of_operation_display=1 PROFILE_POSITION position_actual_value=0"
    )
    assert "EMCY[1] 7305h encoder_loss register=21h" in told
    assert any(
        "FAULT" in line for line in told[told.index("EMCY[1] 7305h encoder_loss register=21h") :]
    )
    assert not [line for line in told if "unknown" in line or "belongs to no" in line]


def test_the_line_of_the_manual():
    decoder = Decoder()
    tell(
        "601#23001A0220006460", "581#60001A0200000000", "601#2F001A0002000000",
        "581#60001A0000000000", decoder=decoder,
    )
    assert tell("181#3706E02E0000", decoder=decoder) == [
        "TPDO1[1] statusword=0637h OPERATION_ENABLED target_reached position_actual_value=12000"
    ]


def test_a_changed_identifier_is_followed_and_a_reset_ends_it():
    session = Session()
    session.map_tpdo1(cob_id=0x400001C1)
    session.send("000#0101")
    decoder = Decoder()
    session.told(decoder)
    image = "1C1#37060100000000"
    assert tell(image, decoder=decoder)[0].startswith("TPDO1[1] statusword=0637h")
    assert tell("181#3706", decoder=decoder) == ["unknown 181#3706"]
    tell("000#8101", decoder=decoder)
    assert tell("181#3706", decoder=decoder)[0].startswith("TPDO1[1] statusword=0637h")
    assert "TPDO1[1]" not in tell(image, decoder=decoder)[0]


def test_stored_parameters_outlive_a_reset():
    session = Session()
    session.map_tpdo1()
    session.write(0x1010, 1, 4, 0x65766173)
    session.send("000#8101")
    decoder = Decoder()
    session.told(decoder)
    assert "position_actual_value=5" in tell("181#37060105000000", decoder=decoder)[0]


def test_a_refused_write_changes_nothing():
    session = Session()
    session.write(0x1A00, 0, 1, 0)  # refused: the PDO is valid
    told = session.told(decoder := Decoder())
    assert told[-1] == (
        "SDO[1] abort 06010000h unsupported access to an object: "
        "tpdo1_number_of_mapped_objects (1A00h:00)"
    )
    assert tell("181#3706", decoder=decoder)[0].startswith("TPDO1[1] statusword=0637h")


def test_what_is_read_of_a_mapping_is_followed_too():
    decoder = Decoder()
    tell("601#40001A0100000000", "581#43001A0110007760", decoder=decoder)
    assert tell("181#0500", decoder=decoder) == ["TPDO1[1] torque_actual_value=5"]


@pytest.mark.parametrize(
    ("frame", "line"),
    [
        ("000#0100", "NMT start all nodes"),
        ("000#0203", "NMT stop node 3"),
        ("000#8003", "NMT enter pre-operational node 3"),
        ("000#8100", "NMT reset all nodes"),
        ("000#8203", "NMT reset communication node 3"),
        ("080#05", "SYNC 5"),
        ("080#", "SYNC"),
        ("100#40E201000100", "TIME 1984-01-02 00:02:03.456"),
        ("703#00", "boot-up[3]"),
        ("703#7F", "heartbeat[3] PRE-OPERATIONAL"),
        ("703#R", "guarding[3] request"),
        ("703#85", "guarding[3] OPERATIONAL toggle=1"),
        ("081#0573210000000000", "EMCY[1] 7305h encoder_loss register=21h"),
        ("081#0000000000000000", "EMCY[1] 0000h no error register=00h"),
        ("081#1034050102030405", "EMCY[1] 3410h voltage register=05h manufacturer=0102030405"),
        ("601#2B4060000F000000", "SDO[1] write controlword (6040h:00) = 000Fh ENABLE_OPERATION"),
        ("581#6040600000000000", "SDO[1] write controlword (6040h:00) done"),
        ("601#4041600000000000", "SDO[1] read statusword (6041h:00)"),
        ("581#437A6000C7CFFFFF", "SDO[1] read target_position (607Ah:00) = -12345"),
        ("601#8041600000000405", "SDO[1] abort 05040000h SDO protocol timed out: statusword "
         "(6041h:00), by the client"),
        ("581#4F00300055000000", "SDO[1] read unknown object (3000h:00) = 55 (bytes)"),
        ("181#R", "TPDO1[1] request"),
        ("201#06", "RPDO1[1] 06 (too short)"),
        ("201#0600AB", "RPDO1[1] controlword=0006h SHUTDOWN and AB"),
        ("301#0102", "RPDO2[1] 01 02 (nothing mapped)"),
        ("7E5#0401000000000000", "LSS switch state global mode=1"),
        ("7E5#1105000000000000", "LSS configure node-id node_id=5"),
        ("7E4#1100000000000000", "LSS configure node-id error=0 specific=0"),
        ("7E5#5178563412800001", "LSS fast scan id_number=12345678h bit_check=128 lss_sub=0 "
         "lss_next=1"),
        ("7E4#4F00000000000000", "LSS identified"),
        ("7E5#FF00000000000000", "unknown 7E5#FF00000000000000"),
        ("7FF#0102", "unknown 7FF#0102"),
        ("601#404160", "unknown 601#404160"),
        ("00000181#3706", "unknown 181#3706"),
    ],
)
def test_one_frame(frame, line):
    assert tell(frame) == [line]


def test_guarding_is_told_from_heartbeat_by_its_request():
    assert tell("701#05", "701#R", "701#05") == [
        "heartbeat[1] OPERATIONAL", "guarding[1] request", "guarding[1] OPERATIONAL toggle=0",
    ]


def test_the_mode_names_the_bits():
    decoder = Decoder()
    words = ("201#1F00", "181#3716")
    pp = ["new_set_point", "set_point_acknowledge"]
    hm = ["homing_operation_start", "homing_attained"]
    for mode, names in ((1, pp), (6, hm)):
        tell(f"601#2F606000{mode:02X}000000", "581#6060600000000000", decoder=decoder)
        for line, name in zip(tell(*words, decoder=decoder), names, strict=True):
            assert line.endswith(name)


def test_a_segmented_upload_is_put_together():
    session = Session()
    session.send("601#4008100000000000")
    for n in range(5):
        session.send(f"601#{0x60 | n % 2 << 4:02X}00000000000000")
    told = session.told()
    assert "SDO[1] read manufacturer_device_name (1008h:00), segmented, 30 bytes" in told
    assert "SDO[1] read manufacturer_device_name (1008h:00), 14 of 30 bytes" in told
    assert told[-1] == f'SDO[1] read manufacturer_device_name (1008h:00) = "{NAME}"'


def test_a_segmented_download_is_put_together_and_learnt():
    session = Session()
    session.send("601#2160600001000000", "601#0D06000000000000")
    told = session.told(decoder := Decoder())
    assert told[-2:] == [
        "SDO[1] write modes_of_operation (6060h:00) = 6 HOMING",
        "SDO[1] write modes_of_operation (6060h:00) done",
    ]
    assert tell("201#1F00", decoder=decoder)[0].endswith("homing_operation_start")


@pytest.mark.parametrize("size", [1, 2, 127])
def test_a_block_upload_is_put_together_though_a_part_is_lost(size):
    session = Session()
    session.send(Frame(0x601, struct.pack("<BHBB3x", 0xA4, 0x1008, 0, size)))
    session.send("601#A300000000000000")
    lost, taken = True, 0
    while taken < 5:
        sent = min(size, 5 - taken)
        received = sent - 1 if lost and sent > 1 else sent
        lost = False
        taken += received
        session.send(Frame(0x601, bytes([0xA2, received, size]) + bytes(5)))
    session.send("601#A100000000000000")
    told = session.told()
    assert told[-2] == f'SDO[1] read manufacturer_device_name (1008h:00) = "{NAME}"'
    assert told[-1] == "SDO[1] read manufacturer_device_name (1008h:00) done"


@pytest.mark.parametrize("right", [True, False])
def test_a_block_download_is_put_together_and_its_crc_checked(right):
    session = Session()
    crc = binascii.crc_hqx(b"\x39\x30\0\0", 0) ^ (not right)
    session.send("601#C67A600004000000", "601#8139300000000000")
    session.send(Frame(0x601, struct.pack("<BH5x", 0xCD, crc)))
    told = session.told()
    value = "SDO[1] write target_position (607Ah:00) = 12345"
    assert told[-2] == (value if right else value + " (CRC wrong)")
    assert told[-1].endswith("done" if right else "CRC error: target_position (607Ah:00)")


def test_nodes_that_are_another_device_are_shown_as_bytes():
    decoder = Decoder("generic", [2])
    assert tell("182#3706", decoder=decoder)[0].startswith("TPDO1[2] statusword=0637h")
    assert tell("181#3706", decoder=decoder) == ["unknown 181#3706"]
    with pytest.raises(ValueError, match=r"node_id = 128 is out of range 1\.\.127"):
        Decoder("generic", [128])


def test_a_pdo_that_one_node_sends_to_another_is_told_for_both():
    decoder = Decoder()
    tell("701#05", "702#05", "602#2301140181010000", "582#6001140100000000", decoder=decoder)
    tell("602#2301160110004060", "582#6001160100000000", decoder=decoder)
    tell("602#2F01160001000000", "582#6001160000000000", decoder=decoder)
    (line,) = tell("181#0F00", decoder=decoder)
    assert line.startswith("TPDO1[1] statusword=000Fh")
    assert line.endswith(" | RPDO2[2] controlword=000Fh ENABLE_OPERATION")


@pytest.mark.parametrize("seed", range(4))
def test_random_and_mutated_frames_are_told_without_an_exception(seed):
    session = Session()
    session.map_tpdo1()
    session.send("601#4008100000000000", "601#6000000000000000", "601#A408100010000000",
                 "601#A300000000000000", "601#C67A600004000000", "601#8139300000000000",
                 "7E5#0401000000000000", "701#R", "080#01", "000#0101", "201#0F00")
    known = [frame for _, frame in session.frames]
    chance = random.Random(seed)
    decoder = Decoder("generic", range(1, 5))
    for _ in range(5_000):
        frame = chance.choice(known)
        data = bytearray(frame.data)
        for _ in range(chance.randint(0, 3)):
            if data:
                data[chance.randrange(len(data))] = chance.randrange(256)
        frame = frame._replace(data=bytes(data[: chance.choice((8, 8, 8, 7, 2, 0))]))
        if chance.random() < 0.3:
            frame = Frame(
                chance.randrange(0x800), chance.randbytes(chance.randint(0, 64)),
                chance.random() < 0.2, chance.random() < 0.1,
            )
        line = decoder.decode(frame)
        assert line
        assert line.isprintable()


def write_log(path, frames):
    with can.Logger(path) as log:
        for time, frame in frames:
            message = to_message(frame)
            message.timestamp = 1_700_000_000 + time * 1e-6
            log(message)


@pytest.fixture(scope="module")
def session():
    session = Session()
    session.send("000#0101", "201#0600", "601#4041600000000000")
    return session


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv", ".log.gz"])
def test_every_kind_of_log_gives_the_same_lines(tmp_path, capsys, session, suffix):
    path = tmp_path / f"run{suffix}"
    write_log(path, session.frames)
    assert cli.main(["decode", str(path), "--node-id", "1", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line[14:] for line in lines] == session.told()
    times = [float(line[:12]) for line in lines]
    begin = session.frames[0][0]
    assert times == pytest.approx([(t - begin) * 1e-6 for t, _ in session.frames], abs=1e-3)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".csv", ".log.gz"])
def test_a_log_that_is_cut_off_is_one_line_and_status_2(tmp_path, refused, session, suffix):
    path = tmp_path / f"run{suffix}"
    write_log(path, session.frames)
    path.write_bytes(path.read_bytes()[:-4])
    error = refused(["decode", str(path)])
    assert error.startswith(f"servogym decode: {path}")
    assert ": damaged or cut off" in error
    text = suffix.removesuffix(".gz") in (".log", ".asc", ".trc", ".csv")
    assert (f"{path}, line " in error) == text


def test_an_error_frame_and_can_fd_are_named(tmp_path, capsys):
    path = tmp_path / "run.log"
    with can.Logger(path) as log:
        log(can.Message(is_error_frame=True))
        log(can.Message(arbitration_id=0x181, is_extended_id=False, is_fd=True, data=bytes(12)))
    assert cli.main(["decode", str(path)]) == 0
    lines = [line[14:] for line in capsys.readouterr().out.splitlines()]
    assert lines == ["error frame", f"CAN FD 181##{'00' * 12}"]


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("run.dat", b"", "unknown suffix, use one of .asc .blf .csv"),
        ("run", b"", "unknown suffix, use one of .asc .blf .csv"),
        ("run.dat.gz", b"", "unknown suffix, use one of .asc .blf .csv"),
        ("missing.log", None, "No such file or directory"),
        ("missing.db", None, "No such file or directory"),
        ("empty.log", b"", "contains no frame"),
        ("wrong.log", b"\x80\x81\xff\n", "damaged or cut off"),
        ("wrong.log", b"what is this\n", "(not a frame: 'what is this')"),
        ("wrong.db", b"what is this", "damaged or cut off"),
    ],
)
def test_a_mistake_is_one_line_and_status_2(tmp_path, refused, name, content, says):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert says in refused(["decode", str(path)])
    assert path.exists() == (content is not None)


@pytest.mark.parametrize(
    ("suffix", "lines"),
    [
        (".csv", ["timestamp,arbitration_id,extended,remote,error,dlc,data",
                  "1.0,0x181,0,0,0,2,NwY=", "1.0,0x181,0,0,zero", "1.0,0x181,0,0,0,2,NwY="]),
        (".log", ["(1.0) can0 181#3706", "(1.0) can0 181#3706", "(1.0) can0 181#37x6"]),
        (".csv.gz", ["t,a,e,r,e,d,d", "1.0,0x181,0,0,0,2,NwY=", "1.0,0xXYZ,0,0,0,2,NwY="]),
    ],
)
def test_a_damaged_line_is_named_with_its_file_and_number(tmp_path, capsys, suffix, lines):
    path = tmp_path / f"run{suffix}"
    with gzip.open(path, "wt") if suffix.endswith(".gz") else path.open("w") as file:
        file.write("\n".join(lines) + "\n")
    assert cli.main(["decode", str(path)]) == 2
    assert f"{path}, line 3: damaged" in capsys.readouterr().err.replace("\n", "")


def test_an_unknown_model_is_one_line_and_status_2(tmp_path, capsys):
    assert cli.main(["decode", str(tmp_path / "run.log"), "--drive", "nothing"]) == 2
    assert "unknown drive model 'nothing': choose one of" in capsys.readouterr().err
