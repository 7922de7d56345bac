"""What can go wrong. All of it is a LightmillError, but for TimeoutError, which is Python's own."""


class LightmillError(Exception):
    """The text says what is wrong and what helps."""


class Unreachable(LightmillError):
    """No master answers. It may be restarting: wait() and watch() go on by themselves."""


class Problem(LightmillError):
    """The master refused a request. `status` is the HTTP status; `title` and `detail` are its own words."""

    def __init__(self, status, title, detail):
        super().__init__(detail or title)
        self.status, self.title, self.detail = status, title, detail


class JobFailed(LightmillError):
    """A job that was waited for has failed, was cancelled or deleted. `status` is the last that was seen of it."""

    def __init__(self, status):
        what = f"job {status.job} is {status.state}"
        super().__init__(f"{what}: {status.message}" if status.get("message") else what)
        self.status = status


class ImageError(LightmillError):
    """Bytes are no image that this package reads."""
