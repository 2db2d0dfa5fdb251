"""MAVLink: bytes to messages to samples and back. No I/O: links and logs carry the bytes."""
