"""Settings of the memory allocator."""

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # parameters of glibc's mallopt
_MAX_THRESHOLD = 2**31 - 1  # bytes


def keep_freed_memory() -> None:
    """Reuse the memory of freed large arrays; without effect on systems without glibc.

    By default glibc returns arrays beyond 32 MiB to the system when they are freed; allocating
    them again takes a tenth of the time of drapes with 101 x 101 vertices. With this setting a
    process keeps its memory until it ends.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return
    mallopt(_MMAP_THRESHOLD, _MAX_THRESHOLD // 2)
    mallopt(_TRIM_THRESHOLD, _MAX_THRESHOLD)
