"""`python -m asterism` is `asterism`."""

import sys

from asterism.server.__main__ import main

sys.exit(main())
