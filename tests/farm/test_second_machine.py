#!/usr/bin/python3
"""The lists of commands by which README.md adds a second machine, pasted as they are written into three machines: namespaces with a
network between them, whose hosts have names, homes and a firewall. The image that is fetched is that of `lightmill render`.

Of all programs only ssh and scp are not real: no server of theirs runs here, so two scripts do what they would.
make copies this to BUILD/tests/farm/test_second_machine, for tests/run.sh.
"""
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
TOP = os.getcwd()
MACHINES = ("first", "second", "third")
PATIENCE = 200  # seconds, on a machine that does other things too

SSH = """#!/bin/sh
host=$1
shift
exec ip netns exec "$host" env HOME="$HOMES/$host" sh -c 'cd && exec sh -c "$*"' sh "$@"
"""
SCP = """#!/bin/sh
exec ssh "${1%%:*}" cat "'${1#*:}'" >"$2/${1##*/}"
"""


def sh(command, **more):
    return subprocess.run(command, shell=True, check=True, text=True, stdout=subprocess.PIPE, **more).stdout


def lists():
    """The lists of the section: for the master, for a worker and for a client."""
    with open("README.md", encoding="utf-8") as file:
        section = re.search(r"(?ms)^## Add a second machine$(.*?)^## ", file.read()).group(1)
    blocks = [re.sub(r"(?m)^    ", "", block) for block in re.findall(r"(?m)(?:^    .*\n)+", section)]
    chosen = [[block for block in blocks if re.search(word, block)] for word in ("--listen", "keygen worker", "keygen client")]
    assert [len(found) for found in chosen] == [1, 1, 1], f"README.md has other lists: {blocks}"
    return [found[0] for found in chosen]


class Machines:
    """Three network namespaces on one bridge."""

    def __init__(self, folder):
        self.folder, self.shells = folder, []
        os.makedirs(f"{folder}/bin")
        for name, text in (("ssh", SSH), ("scp", SCP)):
            with open(f"{folder}/bin/{name}", "w", encoding="ascii") as file:
                file.write(text)
            os.chmod(f"{folder}/bin/{name}", 0o755)
        with open(f"{folder}/hosts", "w", encoding="ascii") as hosts:
            hosts.write("127.0.0.1 localhost\n" + "".join(f"10.7.4.{i + 1} {name}\n" for i, name in enumerate(MACHINES)))
        sh(f"mount --bind {folder}/hosts /etc/hosts && mount -t tmpfs tmpfs /run && ip link add bridge type bridge && ip link set bridge up")
        for i, name in enumerate(MACHINES):
            self.add(i, name)

    def add(self, i, name):
        inside = f"ip netns exec {name}"
        sh(f"ip netns add {name} && ip link add to-{name} type veth peer name eth0 netns {name} && ip link set to-{name} master bridge up"
           f" && {inside} ip link set lo up && {inside} ip link set eth0 up && {inside} ip address add 10.7.4.{i + 1}/24 dev eth0")
        if shutil.which("iptables"):  # nothing but the ports that README.md names
            ports = "--dports 7420,7421" if name == "first" else "--dports 1"
            sh(f"{inside} iptables -A INPUT -i eth0 -m state --state ESTABLISHED -j ACCEPT && {inside} iptables -A INPUT -i eth0 -p tcp"
               f" -m multiport {ports} -j ACCEPT && {inside} iptables -A INPUT -i eth0 -j DROP")
        os.makedirs(f"{self.folder}/{name}/lightmill")
        for part, there in (("build", BUILD), ("scenes", f"{TOP}/scenes")):
            os.symlink(there, f"{self.folder}/{name}/lightmill/{part}")

    def paste(self, name, commands):
        """Into a shell of that machine, as into a terminal."""
        environment = {**{key: value for key, value in os.environ.items() if not key.startswith(("LIGHTMILL", "XDG"))},
                       "HOME": f"{self.folder}/{name}", "HOMES": self.folder, "PATH": f"{self.folder}/bin:{os.environ['PATH']}"}
        with open(f"{self.folder}/{name}.log", "ab") as log:
            shell = subprocess.Popen(["ip", "netns", "exec", name, "sh", "-ex"], stdin=subprocess.PIPE, stdout=log, stderr=log, text=True,
                                     env=environment, cwd=f"{self.folder}/{name}/lightmill", start_new_session=True)
        shell.stdin.write(commands)
        shell.stdin.close()
        self.shells.append(shell)
        return shell

    def wait_for(self, what, ask):
        deadline = time.monotonic() + PATIENCE
        while not ask():
            assert time.monotonic() < deadline, f"there is no {what}\n{self.logs()}"
            time.sleep(0.1)

    def logs(self):
        return sh(f"tail -n +1 {self.folder}/*.log")

    def close(self):
        for shell in self.shells:
            try:
                os.killpg(shell.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            shell.wait()


def pasted_lists_add_machines(machines):
    master, worker, client = lists()
    folder = machines.folder
    machines.paste("first", master)
    machines.wait_for("key of the master", lambda: os.path.exists(f"{folder}/first/lightmill/lightmill-data/keys/allow"))
    for name in ("first", "second"):
        machines.paste(name, worker)
    job = machines.paste("third", client)
    machines.wait_for("image", lambda: job.poll() is not None)
    assert job.returncode == 0, machines.logs()
    machines.wait_for("second worker", lambda: machines.logs().count("joined the master") == 2)
    here = re.search(r"submit (.*?) *#", client).group(1)
    sh(f"{BUILD}/lightmill render {here} --quiet -o {folder}/here.exr")
    hashes = [sh(f"{BUILD}/lightmill info --hash {path}") for path in (f"{folder}/here.exr", f"{folder}/third/lightmill/cornell.exr")]
    assert hashes[0] == hashes[1], hashes


def main():
    if sys.argv[1:] != ["inside"]:  # namespaces of its own, so that nothing outside sees or outlives it
        user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
        namespaces = ["unshare", *user, "--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
        if shutil.which("ip") is None or subprocess.run([*namespaces, "true"], check=False).returncode != 0:
            print("skipped: namespaces are not allowed here, or there is no ip (iproute2)\n[  PASSED  ] 0 tests")
            return
        sys.exit(subprocess.run([*namespaces, sys.argv[0], "inside"], check=False).returncode)
    folder = tempfile.mkdtemp(prefix="lightmill-")
    machines = Machines(folder)
    try:
        pasted_lists_add_machines(machines)
        print("[  PASSED  ] 1 tests")
    finally:
        machines.close()
        shutil.rmtree(folder)


main()
