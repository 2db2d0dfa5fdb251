"""Compiled scan of an ArduPilot dataflash log (.bin): where each message begins.

A message is two bytes A3 95, its type, and as many bytes as the log's own FMT message of that type
says. FMT (type 128, 89 bytes) describes itself. There is no checksum, so after damage a message
counts only when another known one, or the end of the file, follows it.
"""

from companion.jit import step
from companion.samples import Rows

HEAD1, HEAD2 = 0xA3, 0x95
FMT, FMT_LENGTH = 128, 89


@step
def is_message(data: Rows, at: int, lengths: Rows) -> bool:
    """Whether a message of a known type begins at `at` and is complete."""
    size = data.shape[0]
    if at + 3 > size or data[at] != HEAD1 or data[at + 1] != HEAD2:
        return False
    length = int(lengths[int(data[at + 2])])
    return length >= 3 and at + length <= size


@step
def scan_messages(data: Rows, offset: int, lengths: Rows, places: Rows, found: Rows) -> int:
    """Index messages from `offset` on until the file or the index is full.

    Parameters
    ----------
    data : uint8, shape (n,), the file.
    lengths : int64, shape (256,), bytes of a message by type, 0 for unknown types; kept up to date.
    places : int64, shape (m,), filled with where messages begin.
    found : int64, shape (2,): how many messages were indexed, and how many bytes were skipped.

    Returns
    -------
    offset to go on from; the size of the file when it is done.
    """
    size, count, lost = data.shape[0], 0, False
    while offset < size and count < places.shape[0]:
        good = is_message(data, offset, lengths)
        if good and lost:
            after = offset + int(lengths[int(data[offset + 2])])
            good = after >= size - 3 or is_message(data, after, lengths)
        if not good:
            lost = True
            found[1] += 1
            offset += 1
            continue
        lost = False
        kind = int(data[offset + 2])
        if kind == FMT:
            lengths[int(data[offset + 3])] = int(data[offset + 4])
        places[count] = offset
        count += 1
        offset += int(lengths[kind]) if kind != FMT else FMT_LENGTH
    found[0] = count
    return offset
