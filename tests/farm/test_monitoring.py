#!/usr/bin/env python3
"""The example configuration, the alert rules and the dashboard of ops/ with a real Prometheus that watches a real farm.

Every expression of the dashboard must give a sample, every metric that it or a rule names must exist, and every rule
must be evaluated without an error. make copies this to BUILD/tests/farm/test_monitoring, for tests/run.sh.
"""
import json
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

PATIENCE = 60  # seconds for anything, on a machine that does other things too
BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
ALERTS = "ops/prometheus/alerts.yml"
DASHBOARD = "ops/grafana/lightmill.json"
started = []


def read(path):
    with open(path, encoding="utf-8") as file:
        return file.read()


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def start(folder, name, *arguments):
    with open(f"{folder}/{name}.log", "wb") as log:
        process = subprocess.Popen(arguments, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
    started.append(process)
    return process


def wait_for(what, ask):
    """Asks until there is an answer that is true, and returns it; ask says with an exception or "" that there is none."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            answer, why = ask(), "no answer"
            if answer:
                return answer
        except (OSError, AssertionError) as error:
            why = error
        if time.monotonic() > deadline:
            raise AssertionError(f"{what}: {why}")
        time.sleep(0.3)


class Prometheus:
    """The API of a running one."""

    def __init__(self, port):
        self.root = f"http://127.0.0.1:{port}"

    def get(self, path):
        try:
            with urllib.request.urlopen(self.root + path, timeout=10) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as error:
            raise AssertionError(error.read().decode()) from error

    def query(self, expression):
        return self.get("/api/v1/query?" + urllib.parse.urlencode({"query": expression}))["result"]

    def must_give(self, expression):
        wait_for(expression, lambda: self.query(expression))

    def rules(self):
        found = [rule for group in self.get("/api/v1/rules")["groups"] for rule in group["rules"]]
        assert found and all(rule["health"] == "ok" for rule in found), f"rules: {found}"
        return {rule["name"]: rule["state"] for rule in found}


def start_farm(folder):
    start(folder, "master", f"{BUILD}/lightmill-master", "--listen", "127.0.0.1:0", "--data", f"{folder}/data",
          "--http", "0", "--batch-interval", "0.5", "--checkpoint", "1", "--heartbeat", "0.2")
    said = wait_for("the master", lambda: re.search(r"listening on tcp://(127\.0\.0\.1:\d+)", read(f"{folder}/master.log")))
    page = wait_for("the page", lambda: read(f"{folder}/data/http"))
    start(folder, "worker", f"{BUILD}/lightmill-worker", said[1], "--threads", "1", "--cache", f"{folder}/cache")
    subprocess.run([f"{BUILD}/lightmill", "submit", "scenes/cornell", "--master", said[1], "--resolution", "64x64",
                    "--spp", "1000000", "--error", "0.0001"], check=True, stdout=subprocess.DEVNULL)
    return re.search(r"127\.0\.0\.1:\d+", page)[0]


def start_prometheus(folder, target):
    """With the example as it is, but for addresses, paths and times."""
    with open(f"{folder}/token", "w", encoding="utf-8") as file:
        file.write(re.search(r"^view (\w+)$", read(f"{folder}/data/keys/http"), re.M)[1])
    text = read("ops/prometheus/prometheus.yml")
    for old, new in (("15s", "1s"), ("127.0.0.1:7480", target), ("/etc/prometheus/lightmill.token", f"{folder}/token"),
                     ("/etc/prometheus/alerts.yml", os.path.abspath(ALERTS))):
        assert old in text, old
        text = text.replace(old, new)
    with open(f"{folder}/prometheus.yml", "w", encoding="utf-8") as file:
        file.write(text)
    port = free_port()
    start(folder, "prometheus", "prometheus", f"--config.file={folder}/prometheus.yml",
          f"--storage.tsdb.path={folder}/tsdb", f"--web.listen-address=127.0.0.1:{port}", "--log.level=warn")
    return Prometheus(port)


def dashboard_expressions():
    found = [target["expr"] for panel in json.loads(read(DASHBOARD))["panels"] for target in panel["targets"]]
    assert len(found) > 10
    for variable, value in (("$__rate_interval", "10s"), ("$instance", ".*"), ("$render", ".*")):
        found = [expression.replace(variable, value) for expression in found]
    assert not any("$" in expression for expression in found), found
    return found


def check_farm(folder):
    prometheus = start_prometheus(folder, start_farm(folder))
    prometheus.must_give('up{job="lightmill"} == 1')
    for expression in dashboard_expressions():
        prometheus.must_give(expression)
    for metric in sorted(set(re.findall(r"\blightmill_\w+", read(ALERTS) + read(DASHBOARD)))):
        prometheus.must_give(metric)
    assert prometheus.rules()["LightmillAbsent"] == "inactive"
    started[0].send_signal(signal.SIGKILL)
    wait_for("LightmillAbsent", lambda: prometheus.rules()["LightmillAbsent"] == "pending")


def main():
    subprocess.run(["promtool", "check", "rules", ALERTS], check=True)
    subprocess.run(["promtool", "test", "rules", "ops/prometheus/alerts_test.yml"], check=True)
    with tempfile.TemporaryDirectory(prefix="lightmill-", ignore_cleanup_errors=True) as folder:
        try:
            check_farm(folder)
        finally:
            for process in started:
                process.kill()
                process.wait()
    print("[  PASSED  ] 1 test")


main()
