"""Import this before everything else to time one core: libraries read it as they are loaded."""

import os

from common.workers import WORKER_ENVIRONMENT

os.environ.update(WORKER_ENVIRONMENT)
