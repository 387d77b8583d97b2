"""From a picture to what is seen in it. The only place that knows OpenCV."""

import os

# Read by OpenCV when it is loaded: no file may ask for gigabytes (its own limit is 1,000 megapixels), and what is wrong
# with a file is said in our error, not on the standard error stream.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(100_000_000))
os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
