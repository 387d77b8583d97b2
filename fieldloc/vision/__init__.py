"""From a picture to what is seen in it. The only place that knows OpenCV."""
