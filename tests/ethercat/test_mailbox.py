"""The mailbox alone, bytes in and bytes out: ETG.1000.4, 5.6."""

import copy
import random

import pytest

from servogym.drive.ethercat.mailbox import QUEUE, Kind, Mailbox, MailboxError, pack

ECHO = {Kind.COE: lambda body, size: (body,)}


@pytest.fixture
def mailbox():
    return Mailbox(dict(ECHO))


def hexed(text):
    return bytes.fromhex(text)


def taken(mailbox):
    telegram = mailbox.next()
    mailbox.sent()
    return telegram


def test_a_telegram_has_six_bytes_before_its_body():
    # length 3 | address 1001h | channel 0, priority 0 | type CoE 3, counter 5 | body
    assert pack(Kind.COE, b"abc", 5, 0x1001) == hexed("0300 0110 00 53 616263")


def test_an_answer_has_the_type_address_and_channel_of_its_request(mailbox):
    mailbox.receive(pack(Kind.COE, b"xy", 0, 0x1001, 0x42))
    assert taken(mailbox) == hexed("0200 0110 42 13 7879")


def test_counters_of_answers_go_from_1_to_7_and_begin_anew(mailbox):
    seen = []
    for n in range(16):
        mailbox.receive(pack(Kind.COE, bytes([n]), n % 7 + 1))
        seen.append(taken(mailbox)[5] >> 4)
        mailbox.fetched()
    assert seen == [1, 2, 3, 4, 5, 6, 7] * 2 + [1, 2]


@pytest.mark.parametrize(
    ("buffer", "detail"),
    [
        (pack(Kind.EOE, bytes(4)), MailboxError.UNSUPPORTED_PROTOCOL),
        (pack(Kind.ERROR, bytes(4)), MailboxError.UNSUPPORTED_PROTOCOL),
        (pack(9, bytes(4)), MailboxError.UNSUPPORTED_PROTOCOL),
        (hexed("0000 0000 00 03"), MailboxError.SIZE_TOO_SHORT),
        (hexed("0500 0000 00 03 01020304"), MailboxError.INVALID_SIZE),
        (hexed("ffff 0000 00 03 01020304"), MailboxError.INVALID_SIZE),
        (b"\1\2\3", MailboxError.INVALID_SIZE),
    ],
)
def test_30_what_nobody_can_serve_gets_a_mailbox_error(mailbox, buffer, detail):
    mailbox.receive(buffer)
    # length 4 | address | channel | type error 0, counter 1 | command 1 | detail
    answer = taken(mailbox)
    assert answer[:2] == hexed("0400")
    assert answer[4:] == hexed("00 10 0100") + detail.to_bytes(2, "little")
    assert mailbox.next() == b""


def test_an_error_of_a_service_becomes_a_mailbox_error():
    mailbox = Mailbox({Kind.COE: lambda body, size: MailboxError.SERVICE_NOT_SUPPORTED})
    mailbox.receive(pack(Kind.COE, bytes(2)))
    assert taken(mailbox)[6:] == hexed("0100 0400")


def test_a_telegram_that_the_master_repeats_before_its_answer_is_served_once(mailbox):
    request = pack(Kind.COE, b"one", 3)
    mailbox.receive(request)
    mailbox.receive(request)
    assert taken(mailbox)
    assert mailbox.next() == b""
    mailbox.receive(request)
    assert mailbox.next() == b"", "its answer still waits in sync manager 1"
    mailbox.fetched()
    mailbox.receive(request)
    assert mailbox.next(), "a new request of a master that does not count"


def test_telegrams_without_a_counter_are_all_served(mailbox):
    for _ in range(2):
        mailbox.receive(pack(Kind.COE, b"one"))
    assert taken(mailbox)
    assert mailbox.next()


def test_the_last_telegram_comes_again_bit_by_bit(mailbox):
    assert mailbox.again() == b""
    for body in (b"one", b"two"):
        mailbox.receive(pack(Kind.COE, body))
        sent = taken(mailbox)
        assert mailbox.again() == sent == mailbox.again()


def test_what_was_posted_waits_its_turn(mailbox):
    mailbox.receive(pack(Kind.COE, b"answer"))
    mailbox.post(Kind.COE, b"emergency")
    assert taken(mailbox)[6:] == b"answer"
    assert taken(mailbox)[6:] == b"emergency"


def test_no_request_is_taken_while_the_queue_is_full(mailbox):
    for n in range(QUEUE):
        assert mailbox.ready
        mailbox.receive(pack(Kind.COE, bytes([n])))
    assert not mailbox.ready


def test_a_mailbox_goes_on_where_its_state_was_taken(mailbox):
    for n in range(3):
        mailbox.receive(pack(Kind.COE, bytes([n]), n + 1))
    taken(mailbox)
    other = Mailbox(dict(ECHO))
    for name in Mailbox.KEPT:
        setattr(other, name, copy.deepcopy(getattr(mailbox, name)))
    assert other.again() == mailbox.again()
    assert [taken(other) for _ in range(2)] == [taken(mailbox) for _ in range(2)]


def test_30_noise_is_always_answered(mailbox):
    generator = random.Random(3)
    for _ in range(20_000):
        mailbox.reset()
        mailbox.receive(generator.randbytes(generator.randrange(40)))
        assert mailbox.next()
