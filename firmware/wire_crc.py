"""Print the crc32 of what protocol.h declares: its text without comments and with single spaces."""

import re
import sys
import zlib
from pathlib import Path


def wire_crc(text: str) -> int:
    """crc32 of the declarations in ``text``; comments and layout do not count."""
    bare = re.sub(r"/\*.*?\*/", " ", text, flags=re.S)
    return zlib.crc32(" ".join(bare.split()).encode())


if __name__ == "__main__":
    print(f"0x{wire_crc(Path(sys.argv[1]).read_text(encoding='utf-8')):08x}UL")
