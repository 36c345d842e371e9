"""Limit numerical libraries to one thread; import it first, libraries read the limit on loading."""

import os

from common.workers import ONE_THREAD

os.environ.update(ONE_THREAD)
