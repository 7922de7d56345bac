#!/usr/bin/python3
"""docs/openapi.yaml: is it right by the rules of OpenAPI 3.1, and are the answers of a real master those that it describes?

Every operation is asked on a farm with workers that render, and every answer must have a status, a type and a body that the
description knows: a member that it does not know fails. Bodies of requests that the master takes or refuses must be taken or
refused by their schemas. make copies this to BUILD/tests/farm/test_openapi, for tests/run.sh. It runs by Debian's Python, which
has Debian's jsonschema.
"""
import hashlib
import http.client
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time

import jsonschema
import yaml

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
PATIENCE = 60  # seconds for anything, on a machine that does other things too
METHODS = ("get", "put", "post", "delete", "options", "head", "patch", "trace")
GENERAL = {400, 403, 405, 413, 421}  # that any request may get, as the description says in words


# ---- the file -----------------------------------------------------------------------------------------------------------

class Loader(yaml.SafeLoader):
    """YAML without its trap: a key that stands twice is an error, and not the last of both."""


def mapping(loader, node):
    keys = [loader.construct_object(key) for key, _ in node.value]
    assert len(keys) == len(set(keys)), f"line {node.start_mark.line + 1}: a key stands twice: {keys}"
    return loader.construct_mapping(node, deep=True)


Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, mapping)

# What each object of OpenAPI 3.1 may have; a * must be there.
FIELDS = {
    "root": "openapi* info* servers paths* components security tags externalDocs webhooks jsonSchemaDialect",
    "info": "title* version* summary description termsOfService contact license",
    "server": "url* description variables",
    "components": "schemas responses parameters examples requestBodies headers securitySchemes links callbacks pathItems",
    "path": "summary description servers parameters " + " ".join(METHODS),
    "operation": "tags summary description externalDocs operationId parameters requestBody responses* callbacks deprecated security servers",
    "parameter": "name* in* description required deprecated allowEmptyValue style explode allowReserved schema content example examples",
    "header": "description required deprecated style explode schema content example examples",
    "body": "description content* required",
    "media": "schema example examples encoding",
    "response": "description* headers content links",
    "security scheme": "type* description name in scheme bearerFormat flows openIdConnectUrl",
}
KEYWORDS = set("""$ref $defs $comment type enum const multipleOf maximum exclusiveMaximum minimum exclusiveMinimum maxLength minLength
    pattern maxItems minItems uniqueItems prefixItems items contains maxProperties minProperties required properties
    patternProperties additionalProperties propertyNames dependentRequired dependentSchemas allOf anyOf oneOf not if then else
    unevaluatedItems unevaluatedProperties title description default deprecated readOnly writeOnly examples format
    discriminator xml externalDocs example""".split())


class Description:
    def __init__(self, path):
        with open(path, encoding="utf-8") as file:
            self.doc = yaml.load(file, Loader)

    def resolve(self, thing):
        """What a reference stands for."""
        if "$ref" not in thing:
            return thing
        assert thing["$ref"].startswith("#/"), thing
        found = self.doc
        for part in thing["$ref"][2:].split("/"):
            assert part in found, f"{thing['$ref']} leads nowhere"
            found = found[part]
        return self.resolve(found)

    # -- the rules of OpenAPI

    def fields(self, kind, thing, where):
        assert isinstance(thing, dict), f"{where} is no {kind}"
        fields = FIELDS[kind].split()
        unknown = {key for key in thing if not key.startswith("x-")} - {field.rstrip("*") for field in fields}
        missing = {field[:-1] for field in fields if field.endswith("*")} - set(thing)
        assert not unknown and not missing, f"{where}: a {kind} with {unknown}, without {missing}"
        for key in ("summary", "description", "title", "name"):
            assert isinstance(thing.get(key, ""), str), f"{where}: {key} is no text: {thing[key]}"

    def check(self):
        doc = self.doc
        self.fields("root", doc, "the file")
        self.fields("info", doc["info"], "info")
        assert re.fullmatch(r"3\.1\.\d+", doc["openapi"]) and isinstance(doc["info"]["version"], str)
        for server in doc.get("servers", []):
            self.fields("server", server, "servers")
        self.check_components(doc["components"])
        self.check_security(doc.get("security", []))
        shapes = [re.sub(r"\{[^}]*\}", "{}", path) for path in doc["paths"]]
        assert len(shapes) == len(set(shapes)), "two paths are the same"
        for path, item in doc["paths"].items():
            self.check_path(path, item)
        print(f"{len(shapes)} paths, {len(doc['components']['schemas'])} schemas follow the rules")

    def check_components(self, components):
        self.fields("components", components, "components")
        for group in components.values():
            for name in group:
                assert re.fullmatch(r"[a-zA-Z0-9._-]+", name), name
        for name, schema in components.get("schemas", {}).items():
            self.check_schema(schema, name)
        for name, response in components.get("responses", {}).items():
            self.check_response(response, name)
        for name, scheme in components.get("securitySchemes", {}).items():
            self.fields("security scheme", scheme, name)
            assert scheme["type"] == "http" and "scheme" in scheme, name

    def check_security(self, security):
        for choice in security:
            assert set(choice) <= set(self.doc["components"]["securitySchemes"]), choice

    def check_path(self, path, item):
        assert path.startswith("/"), path
        self.fields("path", item, path)
        for method in METHODS:
            if method in item:
                self.check_operation(path, item, item[method], f"{method} {path}")

    def check_operation(self, path, item, operation, where):
        self.fields("operation", operation, where)
        self.check_security(operation.get("security", []))
        named = {}
        for parameter in item.get("parameters", []) + operation.get("parameters", []):
            parameter = self.resolve(parameter)
            self.check_parameter(parameter, where)
            assert named.setdefault((parameter["in"], parameter["name"]), parameter) is parameter, f"{where}: {parameter} twice"
        assert {name for place, name in named if place == "path"} == set(re.findall(r"\{([^}]*)\}", path)), where
        if "requestBody" in operation:
            body = self.resolve(operation["requestBody"])
            self.fields("body", body, where)
            self.check_content(body["content"], where)
        assert operation["responses"], where
        for status, response in operation["responses"].items():
            assert isinstance(status, str) and re.fullmatch(r"[1-5](\d\d|XX)|default", status), f"{where}: {status}"
            self.check_response(self.resolve(response), f"{where} {status}")

    def check_parameter(self, parameter, where):
        self.fields("parameter", parameter, where)
        assert parameter["in"] in ("path", "query", "header", "cookie") and ("schema" in parameter) != ("content" in parameter), where
        assert parameter["in"] != "path" or parameter.get("required") is True, f"{where}: a part of a path is required"
        self.check_schema(parameter["schema"], where)

    def check_response(self, response, where):
        self.fields("response", response, where)
        self.check_content(response.get("content", {}), where)
        for header in response.get("headers", {}).values():
            self.fields("header", header, where)
            self.check_schema(header["schema"], where)
        for schema in response.get("x-data", {}).values():
            self.check_schema(schema, where)

    def check_content(self, content, where):
        for kind, media in content.items():
            assert re.fullmatch(r"[\w.+-]+/[\w.+-]+", kind), f"{where}: {kind}"
            self.fields("media", media, where)
            self.check_schema(media.get("schema", True), where)

    def check_schema(self, schema, where):
        """By JSON Schema 2020-12, whose validators skip keywords that they do not know: these are errors here. So are objects
        that would let members pass which nobody has described."""
        jsonschema.Draft202012Validator.check_schema(schema)
        if isinstance(schema, bool):
            return
        assert set(schema) <= KEYWORDS, f"{where}: {set(schema) - KEYWORDS}"
        self.resolve(schema)
        if schema.get("type") == "object":
            assert "additionalProperties" in schema, f"{where}: an object that may have any members"
        missing = set(schema.get("required", [])) - set(schema.get("properties", schema.get("required", [])))
        assert not missing, f"{where}: {missing} are required and not described"
        for key in ("items", "not", "if", "then", "else", "additionalProperties"):
            if key in schema:
                self.check_schema(schema[key], f"{where} {key}")
        for key in ("allOf", "anyOf", "oneOf"):
            for part in schema.get(key, []):
                self.check_schema(part, f"{where} {key}")
        for name, part in schema.get("properties", {}).items():
            self.check_schema(part, f"{where}.{name}")

    # -- what it says of a request

    def errors(self, schema, value):
        resolver = jsonschema.RefResolver("", self.doc)
        return [f"{'/'.join(map(str, error.absolute_path))}: {error.message}"
                for error in jsonschema.Draft202012Validator(schema, resolver=resolver).iter_errors(value)]

    def operation(self, method, path):
        """The template of a path, and the operation; None when it does not describe the request."""
        for template, item in self.doc["paths"].items():
            if re.fullmatch(re.sub(r"\\\{[^}]*\\\}", "[^/]+", re.escape(template)), path) and method.lower() in item:
                return template, item[method.lower()]
        return None, None


# ---- the farm -----------------------------------------------------------------------------------------------------------

def read(path, mode="r"):
    with open(path, mode) as file:
        return file.read()


def wait_for(what, ask):
    deadline = time.monotonic() + PATIENCE
    while not (answer := ask()):
        assert time.monotonic() < deadline, f"there is no {what}"
        time.sleep(0.05)
    return answer


class Farm:
    """A master with a page and a worker, of real processes."""

    def __init__(self):
        self.folder = tempfile.mkdtemp(prefix="lightmill-")
        self.processes = []
        self.start("master", f"{BUILD}/lightmill-master", "--listen", "127.0.0.1:0", "--data", f"{self.folder}/data", "--http", "0",
                   "--batch-interval", "0.2", "--checkpoint", "0.5", "--heartbeat", "0.2", "--blob-limit", "1")
        said = wait_for("master", lambda: re.search(r"listening on tcp://(\S+)(?s:.*)the page is at http://127\.0\.0\.1:(\d+)",
                                                    read(f"{self.folder}/master.log")))
        self.address, self.port = said[1], int(said[2])
        self.tokens = dict(re.findall(r"^(view|operate) (\w+)$", read(f"{self.folder}/data/keys/http"), re.M))

    def start(self, name, *arguments):
        with open(f"{self.folder}/{name}.log", "wb") as log:
            self.processes.append(subprocess.Popen(arguments, stdout=log, stderr=log, stdin=subprocess.DEVNULL))

    def start_worker(self):
        self.start("worker", f"{BUILD}/lightmill-worker", self.address, "--threads", "1", "--cache", f"{self.folder}/cache")

    def close(self):
        for process in self.processes:
            process.kill()
            process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


class Asker:
    """Asks, and holds what comes back against the description."""

    def __init__(self, description, farm):
        self.description, self.farm, self.seen = description, farm, set()

    def ask(self, status, method, path, body=None, right="operate", described=True, **headers):
        """The body of the answer, which must have this status; not `described`: the schema cannot say what is wrong with the
        body of the request."""
        connection = http.client.HTTPConnection("127.0.0.1", self.farm.port, timeout=PATIENCE)
        headers = {name.replace("_", "-"): value for name, value in headers.items()}
        if right:
            headers["Authorization"] = f"Bearer {self.farm.tokens.get(right, right)}"
        connection.request(method, path, body.encode() if isinstance(body, str) else body, headers)
        answer = connection.getresponse()
        text = answer.read()
        connection.close()
        what = f"{method} {path} {status}"
        assert answer.status == status, f"{what}: {answer.status} {text[:500]}"
        value = self.hold(method, path.split("?")[0], answer, text, what)
        if described:
            self.hold_request(method, path.split("?")[0], body, status, what)
        return value

    def hold(self, method, path, answer, text, what):
        template, operation = self.description.operation(method, path)
        responses = operation["responses"] if operation else {}
        if str(answer.status) in responses:
            response = self.description.resolve(responses[str(answer.status)])
            self.seen.add((method, template, answer.status))
        else:
            assert answer.status in GENERAL or operation is None, f"{what} is not described"
            response = self.description.doc["components"]["responses"]["Problem"]
        for name in response.get("headers", {}):
            assert answer.getheader(name), f"{what} lacks the header {name}"
        content = response.get("content", {})
        kind = (answer.getheader("Content-Type") or "").split(";")[0]
        assert kind in content if content else not text, f"{what} has the type {kind}"
        if not kind.endswith("json"):
            return text
        value = json.loads(text)
        errors = self.description.errors(content[kind]["schema"], value)
        assert not errors, f"{what}:\n" + "\n".join(errors)
        assert kind == "application/json" or value["status"] == answer.status, what
        return value

    def hold_request(self, method, path, body, status, what):
        """The schema takes the bodies that the master takes, and refuses those that it refuses."""
        operation = self.description.operation(method, path)[1]
        content = operation.get("requestBody", {}).get("content", {}) if operation else {}
        if body is None or "application/json" not in content or status not in (200, 201, 400):
            return
        errors = self.description.errors(content["application/json"]["schema"], json.loads(body))
        assert bool(errors) == (status == 400), f"{what}: {body}: the schema says {errors or 'yes'}"

    def listen(self, last=None):
        """Events, for ever: (kind, data), held against their schemas."""
        schemas = self.description.doc["paths"]["/api/v1/events"]["get"]["responses"]["200"]["x-data"]
        connection = http.client.HTTPConnection("127.0.0.1", self.farm.port, timeout=PATIENCE)
        headers = {"Authorization": f"Bearer {self.farm.tokens['view']}"}
        connection.request("GET", "/api/v1/events", headers={**headers, "Last-Event-ID": last} if last else headers)
        answer = connection.getresponse()
        assert answer.status == 200 and answer.getheader("Content-Type") == "text/event-stream"
        self.seen.add(("GET", "/api/v1/events", 200))
        kind = None
        for line in answer:
            field, _, value = line.decode().rstrip("\n").partition(": ")
            assert field in ("", "id", "event", "data", "retry"), line
            kind = value if field == "event" else kind
            if field == "data":
                assert kind in schemas, f"an event {kind}"
                errors = self.description.errors(schemas[kind], json.loads(value))
                assert not errors, f"{kind} {value}: {errors}"
                yield kind, json.loads(value)


# ---- the tests ----------------------------------------------------------------------------------------------------------

def make_blob(farm, scene):
    path = f"{farm.folder}/{scene}.blob"
    subprocess.run([f"{BUILD}/lightmill", "import", f"scenes/{scene}", "--quiet", "-o", path], check=True)
    blob = read(path, "rb")
    return blob, hashlib.blake2b(blob, digest_size=32).hexdigest()


def check_uploads(asker, blob, name):
    path, half, size = f"/api/v1/blobs/{name}", len(blob) // 2, len(blob)
    asker.ask(404, "GET", path)
    asker.ask(400, "PUT", path, blob, Content_Range="bytes 5-4/3")
    asker.ask(409, "PUT", path, blob[half:], Content_Range=f"bytes {half}-{size - 1}/{size}")
    assert asker.ask(202, "PUT", path, blob[:half], Content_Range=f"bytes 0-{half - 1}/{size}")["next"] == half
    assert not asker.ask(200, "GET", path, right="view")["complete"]
    assert asker.ask(201, "PUT", path, blob)["complete"]
    asker.ask(200, "PUT", path, blob)
    asker.ask(422, "PUT", path[:-4] + "0000", b"no scene")
    asker.ask(411, "PUT", path, iter([b"x"]), Transfer_Encoding="chunked")
    asker.ask(413, "PUT", path, b"")
    asker.ask(507, "PUT", path[:-4] + "0000", b"x", Content_Range=f"bytes 0-0/{1 << 36}")
    asker.ask(401, "PUT", path, b"x", right=None)
    asker.ask(403, "PUT", path, b"x", right="view")
    asker.ask(401, "GET", path, right="nobody")


def check_submissions(asker, name):
    def submit(status, described=True, **members):
        return asker.ask(status, "POST", "/api/v1/jobs", json.dumps({"blob": name, **members}), described=described)

    submit(201, name="all that can be said", spp=64, time=60, error=0.5, adaptive=True, width=24, height=16, integrator="path",
           sampler="sobol", seed="18446744073709551615", max_depth=3, tile_size=16, film_scale=20, layers=False, cryptomatte=False,
           learn=False, priority=-1, verify=0.5, mixed=True, halves=True)
    submit(201, integrator="vcm", merge_radius=0.5, spp=1)
    for wrong in ({"samples": 4}, {"spp": 0}, {"spp": 1.5}, {"spp": "4"}, {"error": 0}, {"error": 1}, {"time": -1}, {"width": 0, "height": 3}, {"width": 3},
                  {"integrator": "pt"}, {"sampler": 1}, {"seed": -1}, {"seed": "0x4"}, {"max_depth": 101}, {"tile_size": 7},
                  {"film_scale": 41}, {"layers": 1}, {"priority": 1001}, {"verify": 2}, {"mixed": "yes"}, {"halves": None},
                  {"save_at": [0]}, {"save_at": 4}, {"save_at": list(range(1, 66))}, {"name": ""}, {"name": 3}, {"blob": "12"},
                  {"blob": None}, {"cryptomatte": 2}, {"learn": "no"}, {"spectral": 1}, {"merge_radius": -1}, {"light_groups": 3}, {"adaptive": 0}):
        submit(400, **wrong)
    for wrong in ({"light_groups": "a=0,a=1"}, {"save_at": [8, 4]}, {"save_at": [4], "adaptive": True}, {"name": "\u00e4" * 101}):
        submit(400, **wrong, described=False)
    submit(409, blob="0" * 64)
    asker.ask(401, "POST", "/api/v1/jobs", "{}", right=None)
    asker.ask(403, "POST", "/api/v1/jobs", "{}", right="view")
    asker.ask(413, "POST", "/api/v1/jobs", json.dumps({"blob": "x" * 5000}))
    asker.ask(200, "POST", "/api/v1/jobs/1/cancel")
    return submit(201, spp=1 << 20, error=0.001, save_at=[4, 16], width=48, height=32, verify=0.5, seed=7)["job"]


def check_events(asker, job):
    """A whole life of a job, told by events; what is ordered here makes them."""
    events = asker.listen()
    asker.farm.start_worker()
    kinds, notes = set(), set()
    while not {"job", "image", "note", "worker"} <= kinds or not {"checkpoint", "saved"} <= notes:
        kind, data = next(events)
        kinds.add(kind)
        notes.add(data.get("what"))
    asker.ask(200, "POST", f"/api/v1/jobs/{job}/extend", '{"spp": 2000000, "error": 0.0005, "time": 1000}')
    while next(events)[1].get("what") != "extended":
        pass
    assert next(asker.listen("another life-1"))[0] == "lost"


def check_reports(asker, job):
    wait_for("history", lambda: asker.ask(200, "GET", f"/api/v1/jobs/{job}/history", right="view")["points"])
    assert len(asker.ask(200, "GET", "/api/v1/jobs", right="view")["jobs"]) == 3
    assert asker.ask(200, "GET", f"/api/v1/jobs/{job}", right="view")["samples_done"] > 0
    assert len(asker.ask(200, "GET", "/api/v1/workers", right="view")["workers"]) == 1
    assert asker.ask(200, "GET", "/api/v1/farm", right="view")["jobs"]["running"] == 1
    assert asker.ask(200, "GET", "/api/v1/demand", right="view")["workers"] >= 1
    assert b"lightmill_" in asker.ask(200, "GET", "/metrics", right="view")
    asker.ask(200, "GET", "/healthz", right=None)
    asker.ask(200, "GET", "/readyz", right=None)
    for path in ("jobs", "jobs/1", "jobs/1/history", "jobs/1/tiles", "jobs/1/image.exr", "jobs/1/image.png", "workers", "farm", "demand",
                 "events"):
        asker.ask(401, "GET", f"/api/v1/{path}", right=None)
    for path in ("", "/history", "/tiles", "/image.exr", "/image.png"):
        asker.ask(404, "GET", f"/api/v1/jobs/99{path}")
    asker.ask(401, "GET", "/metrics", right=None)


def check_images(asker, job):
    path = f"/api/v1/jobs/{job}/"
    assert asker.ask(200, "GET", path + "tiles?layer=eye&level=0&since=0&x0=0&y0=0&x1=9&y1=9").startswith(b"LMT1")
    asker.ask(400, "GET", path + "tiles?layer=beauty")
    asker.ask(409, "GET", "/api/v1/jobs/1/tiles?layer=albedo")  # it was submitted without layers
    for kind, magic in (("image.exr", b"\x76\x2f\x31\x01"), ("image.png", b"\x89PNG")):
        assert asker.ask(200, "GET", path + kind).startswith(magic)
        assert asker.ask(200, "GET", path + kind + "?at=4").startswith(magic)
        asker.ask(400, "GET", path + kind + "?spp=4")
        asker.ask(409, "GET", path + kind + "?at=5")
    asker.ask(200, "GET", path + "image.exr?half=1&halves=1")
    asker.ask(200, "GET", path + "image.png?exposure=-1.5")
    connection = http.client.HTTPConnection("127.0.0.1", asker.farm.port, timeout=PATIENCE)
    headers = {"Authorization": f"Bearer {asker.farm.tokens['view']}"}
    for kind in ("image.exr", "image.png"):
        connection.request("GET", path + kind + "?at=4", headers=headers)
        answer = connection.getresponse()
        answer.read()
        asker.ask(304, "GET", path + kind + "?at=4", If_None_Match=answer.getheader("ETag"))
    connection.close()


def check_orders(asker, job):
    path = f"/api/v1/jobs/{job}"
    assert asker.ask(200, "POST", path + "/pause")["state"] == "paused"
    for order in ("pause", "resume", "cancel", "retain", "release", "extend", "priority", "mixed", "rebind"):
        body = '{"priority": 1}' if order == "priority" else "{}"
        asker.ask(401, "POST", f"{path}/{order}", body, right=None)
        asker.ask(403, "POST", f"{path}/{order}", body, right="view")
        asker.ask(404, "POST", f"/api/v1/jobs/99/{order}", body)
        asker.ask(413, "POST", f"{path}/{order}", json.dumps({"x": "y" * 5000}))
        asker.ask(400, "POST", f"{path}/{order}", '{"x": 1}')
        asker.ask(405, "GET", f"{path}/{order}")
    asker.ask(409, "POST", path + "/pause")
    asker.ask(409, "POST", path + "/extend")
    asker.ask(409, "POST", "/api/v1/jobs/1/resume")  # it is over
    asker.ask(409, "POST", "/api/v1/jobs/1/cancel")
    asker.ask(400, "POST", path + "/pause", '{"spp": 1}')
    asker.ask(200, "POST", path + "/resume")
    asker.ask(200, "POST", path + "/priority", '{"priority": -7}')
    asker.ask(400, "POST", path + "/priority", '{"priority": 1001}')
    asker.ask(400, "POST", path + "/priority", "{}")
    asker.ask(400, "POST", path + "/extend", '{"error": 2}')
    asker.ask(400, "POST", path + "/extend", '{"samples": 2}')
    asker.ask(200, "POST", path + "/mixed")
    asker.ask(409, "POST", path + "/mixed")
    asker.ask(409, "POST", path + "/rebind")
    asker.ask(200, "POST", path + "/retain")
    asker.ask(200, "POST", path + "/release")
    asker.ask(409, "DELETE", path)
    asker.ask(401, "DELETE", path, right=None)
    asker.ask(403, "DELETE", path, right="view")
    asker.ask(404, "DELETE", "/api/v1/jobs/99")
    asker.ask(200, "POST", path + "/cancel")
    wait_for("end of the job", lambda: asker.ask(200, "GET", path)["state"] == "cancelled")
    asker.ask(204, "DELETE", path)
    asker.ask(421, "GET", "/api/v1/jobs", Host="evil.example")
    asker.ask(403, "GET", "/api/v1/jobs", Origin="http://evil.example")
    asker.ask(404, "GET", "/api/v1/nothing")


def check_all_was_asked(asker):
    """What a test cannot bring about is listed here: a full queue, a broken disk, an end."""
    rare = {500, 503, 507}
    for path, item in asker.description.doc["paths"].items():
        for method in METHODS:
            for status in item.get(method, {}).get("responses", {}):
                key = (method.upper(), path, int(status))
                always = (path.endswith("rebind") and status == "200") or path.endswith(("retain", "release", "priority")) and status == "409"  # one kind of machines; whatever the job's state
                assert key in asker.seen or int(status) in rare or always, f"{key} was never seen"


def main():
    description = Description("docs/openapi.yaml")
    description.check()
    farm = Farm()
    try:
        asker = Asker(description, farm)
        blob, name = make_blob(farm, "cornell")
        check_uploads(asker, blob, name)
        job = check_submissions(asker, name)
        check_events(asker, job)
        check_reports(asker, job)
        check_images(asker, job)
        check_orders(asker, job)
        check_all_was_asked(asker)
    finally:
        farm.close()
    print(f"{len(asker.seen)} kinds of answers\n[  PASSED  ] 2 tests")


main()
