"""Lightmill from Python: submit renders to a master, watch them converge, and get their images as arrays.

    import lightmill
    master = lightmill.Master()                 # of ./lightmill-data; or Master(url, token)
    for job in master.jobs():
        print(job, job.image().mean())
"""
from .errors import ImageError, JobFailed, LightmillError, Problem, Unreachable
from .exr import Image, read_image
from .job import History, Job
from .master import Master
from .report import Report
from .tiles import LiveImage, Tiles

__version__ = "0.1.0"
__all__ = ["History", "Image", "ImageError", "Job", "JobFailed", "LightmillError", "LiveImage", "Master", "Problem", "Report",
           "Tiles", "Unreachable", "read_image"]
