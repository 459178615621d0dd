"""Lost packets and the speed of the head, counted by hand."""

import math

import numpy as np
import pytest

from lidarcfg.packets.loss import HeadSpeed, PacketLossCounter, following, missing_numbers, missing_periods

SECOND_NS = 1_000_000_000


def test_by_numbers():
    """Numbers of a byte: 254 255 0 2 follow but for the 1; a step of more than 10 is a restart, as is one back."""
    number = np.array([254, 255, 0, 2, 2, 12, 23, 22])
    assert missing_numbers(number, 256, 10).tolist() == [0, 0, 1, -1, 9, 0, 0]
    longest = np.array([1, 1, 1, 1, 9.9, 11, 1])  # each in the time that passed
    assert missing_numbers(number, 256, longest).tolist() == [0, 0, 0, -1, 0, 10, 0]


def test_by_stamps():
    gap_ns = np.array([100, 109, 149, 151, 305, 1000, 1001, 0, -100])
    assert missing_periods(gap_ns, 100, 1001).tolist() == [0, 0, 0, 1, 2, 9, 0, 0, 0]
    assert following(gap_ns, 100).tolist() == [True, True, *[False] * 7]


def test_only_what_is_missing_before_wanted_packets_is_lost():
    losses = PacketLossCounter()
    losses.add(np.array([2, 3, -1]), np.array([True, True, False, True]))
    assert losses.lost == 2
    losses.add(np.array([], np.int64), np.array([True]))
    assert losses.lost == 2


def test_what_is_missing_where_the_field_of_view_ends_is_no_loss():
    """Two gaps at 359 and 1 degree, one elsewhere; the end at 0 is known by two signs, and then from before on."""
    losses = PacketLossCounter()
    losses.add(np.array([5, 6, 7]), np.ones(4, np.bool_), np.array([359, 1, 90]))
    losses.add_end(0, 1)
    assert losses.lost == 18
    losses.add_end(359, 1)
    assert losses.lost == 13  # 1 degree is beside 0 alone
    losses.add_end(0, 1)
    assert losses.lost == 7


def test_the_speed():
    """A quarter turn in 25 ms and one of 1/8 in 12.5 ms: 600 rpm."""
    speed = HeadSpeed(36000)
    assert math.isnan(speed.rpm)
    speed.add(np.array([9000, 100, 4500]), np.array([25_000_000, SECOND_NS, 12_500_000]), np.array([True, False, True]))
    assert speed.rpm == pytest.approx(600, rel=1e-12)
