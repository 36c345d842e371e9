"""Import this before everything else to time one core: libraries read it as they are loaded."""

import os

from common.threads import ONE_THREAD

os.environ.update(ONE_THREAD)
