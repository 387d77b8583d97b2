"""python -m fieldloc"""

import sys

from fieldloc.cli import main

sys.exit(main())
