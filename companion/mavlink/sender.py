"""Messages to the frames that we send: an encoder with its sequence numbers for each of our ids."""

from collections.abc import Iterable

from companion.mavlink.codec import Encoder, Message
from companion.mavlink.identity import Identity
from companion.mavlink.signing import Signing


class Sender:
    """Encodes under the ids that `Identity.own` says; signs where `signing` is given."""

    def __init__(self, signing: Signing | None = None) -> None:
        self._signing = signing
        self._encoders: dict[tuple[int, int], Encoder] = {}

    def encode(self, messages: Iterable[Message], identity: Identity) -> list[bytes]:
        """The frames, in the MAVLink version that the vehicle speaks; without messages that it
        cannot carry."""
        own = identity.own
        if own not in self._encoders:
            self._encoders[own] = Encoder(*own, self._signing)
        encoder, spoken = self._encoders[own], identity.spoken
        return [frame for each in messages if (frame := encoder.encode(each, spoken))]
