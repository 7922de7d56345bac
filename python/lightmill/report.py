"""What a master tells of a job, a worker or itself."""


class Report(dict):
    """A JSON object whose members are attributes too: status.error is status["error"]."""

    def __getattr__(self, name):
        try:
            return self[name]
        except KeyError:
            raise AttributeError(f"there is no '{name}' in this report; it has {', '.join(self)}") from None

    @classmethod
    def of(cls, members):
        """Of decoded JSON. Counts that a double cannot hold exactly come as digits, and become numbers."""
        return cls({name: _count(name, value) for name, value in members.items()})


_TEXTS = {"name", "state", "message", "scene", "fingerprint", "key", "address", "version", "aside", "why", "what"}


def _count(name, value):
    return int(value) if isinstance(value, str) and name not in _TEXTS and value.isdigit() else value
