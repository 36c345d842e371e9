"""How this process gets its memory."""

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # numbers of glibc's mallopt
_NEVER = 2**31 - 1  # bytes


def keep_freed_memory() -> None:
    """Keep the memory of large arrays for the next ones; without effect where there is no glibc.

    By default glibc gives arrays beyond 32 MiB back to the system after every use, and fetching
    them again takes a tenth of the time of drapes with 101 x 101 vertices. What a process has once
    used it then keeps to its end.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _NEVER // 2)
    mallopt(_TRIM_THRESHOLD, _NEVER)
