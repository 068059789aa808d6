#!/bin/sh
# Does what the Dockerfile does, without Docker: installs only what serving needs into a fresh
# environment, not editable, serves from an empty directory as another user, and registers the
# example of the service's own API description. Needs root, for the other user.
set -eu
cd "$(dirname "$0")/.."
place=$(mktemp -d)
server=""
leave() {
    [ -z "$server" ] || kill "$server" 2>/dev/null || true
    rm -rf "$place"
}
trap leave EXIT
port=${PORT:-18000}

git archive HEAD | tar -x -C "$place"
"${PYTHON:-python3}" -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet --disable-pip-version-check -c constraints.txt "$place"
mkdir "$place/empty"
chmod 755 "$place"
cd "$place/empty"

if "$place/venv/bin/pip" list 2>/dev/null | grep -iE '^(lightning|pytorch-lightning|torchmetrics|tensorboard|mypy|ruff) '; then
    echo "the image would hold more than serving needs" >&2
    exit 1
fi
HOME=/nonexistent setpriv --reuid nobody --regid nogroup --clear-groups \
    "$place/venv/bin/equivalign" serve --host 127.0.0.1 --port "$port" &
server=$!
"$place/venv/bin/python" - "http://127.0.0.1:$port" <<'PYTHON'
import json
import sys
import time
import urllib.error
import urllib.request

address = sys.argv[1]
for _ in range(600):
    try:
        urllib.request.urlopen(f"{address}/readyz", timeout=5).close()
        break
    except (urllib.error.URLError, ConnectionError):
        time.sleep(0.1)
with urllib.request.urlopen(f"{address}/openapi.json") as answer:
    body = json.load(answer)["paths"]["/register"]["post"]["requestBody"]
example = json.dumps(body["content"]["application/json"]["example"]).encode()
request = urllib.request.Request(f"{address}/register", example, {"Content-Type": "application/json"})
with urllib.request.urlopen(request, timeout=60) as answer:
    result = json.load(answer)
assert result["diagnostics"]["overlap_source"] > 0.9, result["diagnostics"]
print(*result["T_target_source"], sep="\n")
PYTHON
kill -TERM "$server"
wait "$server" || [ $? -eq 143 ] || exit 1
server=""
echo "The image's steps work."
