"""Reference frames of every message of the protocol.

They were computed with the libraries cobs and zlib, independently of `rig.protocol.messages`.
"""

from rig.protocol.messages import (
    Ack,
    Arm,
    Event,
    Follows,
    Heartbeat,
    Hello,
    Ident,
    Message,
    Reading,
    SetLimits,
    SetPressures,
    Stop,
    WaveBegin,
    WavePiece,
    WavePlay,
)

VECTORS: list[tuple[Message, str]] = [
    (Hello(1), "03010105648298e700"),
    (
        SetLimits(2, (300_000, 300_000, 250_000, 0)),
        "03020204e0930404e093040490d003010101010525bfbccf00",
    ),
    (Arm(3), "0303030588342ad600"),
    (
        SetPressures(0x1234, (0, 1, -1, 2**31 - 1)),
        "04043412010101020101010dffffffffffffff7f23313bba00",
    ),
    (Heartbeat(0), "02050105f91b8af900"),
    (Stop(65_535), "0806ffff5fb7ea4500"),
    (WaveBegin(7, 2000, 1_000_000), "03070706d00740420f051dad214700"),
    (WavePiece(8, 256, (1, 2, 3, 4)), "03080801030101010102020101020301010204010105b64e353d00"),
    (
        WavePiece(9, 0, tuple(range(0, 32_000_000, 1_000_000))),
        (
            "0308090101010101010440420f0480841e04c0c62d0103093d04404b4c04808d5b04c0cf6a010312"
            "7a044054890480969804c0d8a701031bb704405dc604809fd504c0e1e4010324f40d4066030180a8"
            "1201c0ea2101102d3101406f400180b14f01c0f35e0110366e0140787d0180ba8c01c0fc9b01143f"
            "ab014081ba0180c3c901c005d901d0375fb200"
        ),
    ),
    (WavePlay(10, 2**32 - 1), "03090a09ffffffff2899d47700"),
    (
        Ident(1, 1, 2, 3, 2000, 500, (400_000,) * 4),
        "0381010b010203d007f401801a0604801a0604801a0604801a06056c1ad22400",
    ),
    (
        Reading(2**32 - 1, 2**40, 2, 0x1234, (0, -5, 300_000, 7, 600_000, 3_300_000, 0, -(2**31))),
        (
            "0682ffffffff010101010201010402341201010108fbffffffe093040207010104c0270904a05a32"
            "0101010101010106807da0b44a00"
        ),
    ),
    (Ack(11, 0x04, 3, 2), "03830b040403020101053fc4839200"),
    (Event(123_456_789, 2, 100), "068415cd5b0701010103026401010524a7805b00"),
    (
        Follows(65_535, 2**33 + 1, (0, 300_000, 7, 0)),
        "0585ffff010101020201010101010104e0930402070101010101010539e233e900",
    ),
]
