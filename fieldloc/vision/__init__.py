"""From a picture to what is seen in it. The only place that knows OpenCV."""

import os

# Read by OpenCV when it is loaded: no file may ask for gigabytes (its own limit is 1,000 megapixels), and what is wrong
# with a file is said in our error, not on the standard error stream.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(100_000_000))
os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")
# One thread, unless the environment says otherwise: a robot has other work for its cores, and where there are many
# pictures, as many processes look at them, each of which would take all cores.
os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")
