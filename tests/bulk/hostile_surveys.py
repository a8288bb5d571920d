"""Survey files that lie about what they hold, or that become far larger than they are."""

import struct
import zlib

_SHORT, _LONG, _DOUBLE = 3, 4, 12


def deflated_zeros(size_bytes: int) -> bytes:
    """A zlib stream (RFC 1950) of so many zeros, rounded down to MiB."""
    zeros = bytes(1024 * 1024)
    packer = zlib.compressobj(9, wbits=-15)
    block = packer.compress(zeros) + packer.flush(zlib.Z_FULL_FLUSH)
    count = size_bytes // len(zeros)
    checksum = (count * len(zeros) % 65521) << 16 | 1
    return b"\x78\xda" + block * count + b"\x03\0" + struct.pack(">I", checksum)


def deflated_raster(size_bytes: int, side_count: int = 30) -> bytes:
    """A GeoTIFF that declares a small raster of heights and whose one strip inflates to so many bytes."""
    strip = deflated_zeros(size_bytes)
    place = struct.pack("<3d6d", 0.2, 0.2, 0.0, 0.0, 0.0, 0.0, 5.0, 5.0, 0.0)
    keys = struct.pack("<8H", 1, 1, 0, 1, 1025, 0, 1, 1)
    tag_count = 13
    place_at = 8 + 2 + 12 * tag_count + 4
    keys_at = place_at + len(place)
    tags = (
        (256, _SHORT, 1, side_count),
        (257, _SHORT, 1, side_count),
        (258, _SHORT, 1, 32),
        (259, _SHORT, 1, 8),
        (262, _SHORT, 1, 1),
        (273, _LONG, 1, keys_at + len(keys)),
        (277, _SHORT, 1, 1),
        (278, _SHORT, 1, side_count),
        (279, _LONG, 1, len(strip)),
        (339, _SHORT, 1, 3),
        (33550, _DOUBLE, 3, place_at),
        (33922, _DOUBLE, 6, place_at + 24),
        (34735, _SHORT, 8, keys_at),
    )
    head = b"II*\0" + struct.pack("<IH", 8, tag_count)
    directory = b"".join(struct.pack("<HHII", *tag) for tag in tags) + struct.pack("<I", 0)
    return head + directory + place + keys + strip
