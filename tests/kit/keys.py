"""CURVE keys: 32 bytes, written as 40 characters of Z85 (ZeroMQ RFC 32); and the files that hold them."""
import os

import zmq.utils.z85


def _lines(path):
    with open(path, encoding="ascii") as file:
        for line in file:
            line = line.strip()
            if line and not line.startswith("#"):
                yield line


def _checked(key):
    if len(key) != 40 or len(zmq.utils.z85.decode(key.encode())) != 32:
        raise ValueError(f"{key} is no key")
    return key


def read_public(path):
    """The public key in NAME.key, or in NAME.secret."""
    for line in _lines(path):
        words = line.split()
        if len(words) == 1:
            return _checked(words[0])
        if words[0] == "public":
            return _checked(words[1])
    raise ValueError(f"{path} holds no public key")


def read_secret(path):
    """(public, secret) of NAME.secret."""
    halves = dict(line.split() for line in _lines(path))
    secret = _checked(halves["secret"])
    public = zmq.curve_public(secret.encode()).decode()
    if halves.get("public", public) != public:
        raise ValueError(f"{path}: the halves are of two keys")
    return public, secret


def make(folder, name):
    """Makes a key and writes NAME.secret and NAME.key; (public, secret)."""
    while True:
        public, secret = (half.decode() for half in zmq.curve_keypair())
        if not public.startswith("#"):  # the line would be a comment
            break
    os.makedirs(folder, exist_ok=True)
    with open(os.open(f"{folder}/{name}.secret", os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w", encoding="ascii") as file:
        file.write(f"public {public}\nsecret {secret}\n")
    with open(f"{folder}/{name}.key", "x", encoding="ascii") as file:
        file.write(f"{public}\n")
    return public, secret
