#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests `relidar serve` like a user: a server process on a small street, Python clients
# with stubs generated from the proto, invalid input, and Ctrl-C. One client compares
# scans with those of `relidar render` bit by bit.
#
#   serve_test.sh RELIDAR RELIDAR_DEV WORK_FOLDER [LAYER_FOLDER]
#
# LAYER_FOLDER: folder with the manifest of the layer that loses the device
# (device_loss/).
# Exits 77 (skipped) if there is no Vulkan device, or no Python with grpcio and numpy.
set -uo pipefail
relidar=$(realpath "${1:?usage: serve_test.sh RELIDAR RELIDAR_DEV WORK_FOLDER}")
relidar_dev=$(realpath "$2")
root=$(realpath "$(dirname "${BASH_SOURCE[0]}")/../..")
work=${3:?usage: serve_test.sh RELIDAR RELIDAR_DEV WORK_FOLDER} layers=${4:-}
[[ -z $layers ]] || layers=$(realpath "$layers")
rm -rf "$work" && mkdir -p "$work" && cd "$work" || exit 1
server=""
source "$root/tests/tools/checks.sh"
trap '[[ -z $server ]] || kill -KILL "$server" 2>/dev/null' EXIT

need_device
python=""
for candidate in python3 /usr/bin/python3; do
    if "$candidate" -c 'import grpc, google.protobuf, numpy' 2>/dev/null; then python=$candidate; break; fi
done
[[ -n $python ]] || { echo "no Python with grpcio, protobuf and numpy"; exit 77; }

before=()   # words that precede the command of a server
# serve ARGS...: starts a server at a free port; sets $server and $address.
serve() {
    "${before[@]}" "$relidar" serve "$@" --listen 127.0.0.1:0 >serve.out 2>serve.err &
    server=$!
    for _ in $(seq 600); do
        address=$(sed -n 's/^serving .* at \([^ ]*\) on .*/\1/p' serve.out)
        [[ -z $address ]] || return 0
        kill -0 "$server" 2>/dev/null || break
        sleep 0.1
    done
    fail "serve $*: it does not come up: $(cat serve.err)"
    exit 1
}

# stop: sends Ctrl-C; the server must end with 0.
stop() {
    kill -INT "$server"
    pid=$server ends 0 "Ctrl-C: $(cat serve.err)"
    server=""
}

mkdir street
printf 'seed = 5\nn_frames = 12\nrows = 8\ncolumns = 96\n' >street/street.toml
# Eight beams leave gaps. After six training steps, only the rims of discs fill the gaps.
"$relidar" train street --out run --preset quick --set train.refine_poses=none --set init.actor_min_points=10 \
    --set image.alpha_min=0.004 --set train.iterations=6 --no-eval --quiet || { fail "no run to serve"; exit 1; }

bad 2 "RUN" serve
bad 3 "nowhere" serve nowhere
bad 2 "--queue: .*0" serve run --queue 0
bad 2 "memory-mib: .*-1" serve run --memory-mib -1
bad 3 "run: .* MiB .*1.0 MiB \(--memory-mib\)" serve run --memory-mib 1
bad 2 "weather: .*snow=-1, .*100 mm/h" serve run --weather snow=-1
bad 2 "tls-cert .*--tls-key" serve run --tls-cert x.pem
bad 3 "run/config.toml: .*PEM" serve run --tls-cert run/config.toml --tls-key run/config.toml
bad 2 "\"run\"; use NAME=RUN" serve run "$PWD/run"
bad 2 "--listen: .*'nonsense', .*HOST:PORT .*65535" serve run --listen nonsense
bad 2 "--listen: .*'127.0.0.1:99999'" serve run --listen 127.0.0.1:99999
bad 2 "--listen: .*'127.0.0.1:-1'" serve run --listen 127.0.0.1:-1
relidar=$relidar_dev bad 2 "serve: found '127.0.0.1:99999', .*HOST:PORT .*1 to 65535" bench --serve 127.0.0.1:99999
bad 2 "192.0.2.1:0: Cannot assign requested address" serve run --listen 192.0.2.1:0 --quiet
relidar=$relidar_dev bad 3 "127.0.0.1:1 .*status 14" bench --serve 127.0.0.1:1

serve town=run
bad 2 "$address: .*process" serve run --listen "$address"
"$relidar_dev" bench --serve "$address" --calls 8 --clients 2 >bench.out || fail "bench --serve: $(cat bench.out)"
grep -q "town .*$address: 8 .*2 .*768 rays" bench.out || fail "bench --serve prints: $(cat bench.out)"
relidar=$relidar_dev bad 3 "status 5: .*scene: found \"city\"" bench --serve "$address" --serve-scene city

# Health of our services (1 = serving), and the list of services by reflection.
"$python" - "$address" <<'PYTHON' || fail "health or reflection"
import sys
import grpc
channel = grpc.insecure_channel(sys.argv[1])
ours = b"relidar.v1.RenderService"
health = channel.unary_unary("/grpc.health.v1.Health/Check")(b"\x0a" + bytes([len(ours)]) + ours, timeout=10)
listed = channel.stream_stream("/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo")(iter([b"\x3a\x00"]), timeout=10)
answer = next(listed)
listed.cancel()   # otherwise Python may wait for the stream forever when it ends
channel.close()
sys.exit(0 if health == b"\x08\x01" and ours in answer else 1)
PYTHON

# Poses from a client and from a file must give the same scan, bit by bit.
printf 'time_s,x,y,z,yaw_deg\n0.4,3.25,0.5,1.73,0\n0.6,5.5,0.25,1.73,0\n' >way.csv
for sensor in "" VLP-16:90x10; do
    rm -rf scans
    "$relidar" render run --out scans --trajectory way.csv --times 0.5:0.5:1 --deskew --boxes --format npz --quiet ${sensor:+--sensor "$sensor"} \
        || fail "render --trajectory"
    "$python" -B "$root/tests/tools/compare_served.py" "$root" "$address" way.csv 0.5 scans/frame_000000.npz "$sensor" \
        || fail "a client's scan of sensor '$sensor' differs from that of render --trajectory"
done

"$python" -B "$root/tools/examples/closed_loop_client.py" "$address" >loop.out 2>&1
grep -q "[0-9] m behind" loop.out || fail "closed_loop_client.py: $(cat loop.out)"
stop
! "$relidar_dev" bench --serve "$address" --calls 1 >/dev/null 2>&1 || fail "it answers after Ctrl-C"

# After the asset is removed, its name must be free.
bad 3 "nowhere: " serve run --assets nowhere
bad 3 "street" serve run --assets street
"$relidar" assets run --out assets --least 0 --quiet || fail "no assets to serve"
serve run --assets assets
for round in first second; do
    "$python" -B "$root/tools/examples/closed_loop_client.py" "$address" "" car-1 >loop.out 2>&1
    grep -q "[0-9] m behind" loop.out || fail "closed_loop_client.py with an asset, $round time: $(cat loop.out)"
done
"$python" -B "$root/tools/examples/closed_loop_client.py" "$address" "" car-7 >loop.out 2>&1
grep -q 'actors\[0\].asset: .*"car-7", .*"car-' loop.out || fail "an unknown asset: $(cat loop.out)"
"$python" -B "$root/tests/tools/carla_test.py" "$root" "$address" carla_scans >carla.out 2>&1 || fail "carla_lidar.py: $(cat carla.out)"
"$python" -B "$root/tests/tools/ros2_test.py" "$root" "$relidar" "$address" ros2 >ros2.out 2>&1 || fail "ros2_lidar.py: $(cat ros2.out)"
stop

# The client implements only the wire format.
bad 2 "--api: .*'alpasim', .*sensorsim" serve run --api alpasim
bad 2 "sensorsim-poses .*--api sensorsim" serve run --sensorsim-poses rotation-first
bad 2 "--sensorsim-poses: .*'xyz', .*rotation-first .*translation-first" serve run --api sensorsim --sensorsim-poses xyz
serve town=run --api sensorsim
"$python" -B "$root/tests/tools/sensorsim_client.py" "$root" "$address" town >sensorsim.out 2>&1 \
    || fail "a client of SensorsimService: $(cat sensorsim.out)"
for package in nre nurec; do
    "$python" -B "$root/tools/examples/alpasim_lidar.py" "$address" $package.grpc.protos $package >$package.out 2>&1 \
        || fail "alpasim_lidar.py: $(cat $package.out)"
    grep -q "frame 2: [1-9][0-9]* points, [1-9]" $package.out && grep -q "town loaded" $package.out || fail "alpasim_lidar.py prints: $(cat $package.out)"
done
diff -r nre nurec || fail "the two packages return different scans"
stop

# Uses a self-signed certificate, which the client trusts explicitly.
if command -v openssl >/dev/null; then
    openssl req -x509 -newkey rsa:2048 -nodes -keyout key.pem -out cert.pem -days 2 -subj /CN=localhost -addext subjectAltName=IP:127.0.0.1 2>/dev/null
    serve run --tls-cert cert.pem --tls-key key.pem
    "$python" -B "$root/tests/tools/compare_served.py" "$root" "$address" way.csv 0.5 scans/frame_000000.npz VLP-16:90x10 cert.pem \
        || fail "a client with TLS"
    ! "$relidar_dev" bench --serve "$address" --calls 1 >/dev/null 2>&1 || fail "a client without TLS is answered by a server with it"
    stop
fi

# More silent connections than descriptors: afterwards, the server must serve again.
before=(bash -c 'ulimit -n 128; exec "$@"' -)
serve run
before=()
"$python" - "$address" <<'PYTHON' || fail "connections that say nothing"
import socket
import sys
host, port = sys.argv[1].rsplit(":", 1)
silent = []
for _ in range(200):
    try:
        silent.append(socket.create_connection((host, int(port)), timeout=5))
    except OSError:
        pass
sys.exit(0 if len(silent) > 90 else 1)
PYTHON
timeout 20 "$relidar_dev" bench --serve "$address" --calls 2 >bench.out 2>&1 || fail "it does not serve after silent connections: $(cat bench.out)"
stop

# A lost device: clients receive UNAVAILABLE, and the server ends with its exit code.
if [[ -n $layers ]]; then
    before=(env VK_INSTANCE_LAYERS=VK_LAYER_RELIDAR_device_loss "VK_ADD_LAYER_PATH=$layers" RELIDAR_LOSE_DEVICE_AFTER=60)
    serve run
    before=()
    relidar=$relidar_dev bad 3 "status 14: .*VK_ERROR_DEVICE_LOST" bench --serve "$address" --calls 1000
    pid=$server ends 4 "a lost device"
    server=""
    [[ $(grep -c . serve.err) == 1 ]] && grep -q "^relidar: .*VK_ERROR_DEVICE_LOST" serve.err || fail "a lost device: $(cat serve.err)"
fi

finish_checks
