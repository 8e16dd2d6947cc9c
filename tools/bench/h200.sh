#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# The whole program against the paper's own tracer on one GPU, in under 8 minutes: the peer's milliseconds beside ours, then every
# kernel of the two largest waymo cases beside its floor. Runs from a source tree or from inside the bundle (tools/dev/bundle), and needs nothing but bash and awk.
#
#   tools/bench/h200.sh [--out DIR] [--repeat N] [--surfels-max N] [relidar options, such as --device 0]
#
# RELIDAR=FILE chooses the program. DIR keeps the JSON of every case. The peer's numbers are its own, from an NVIDIA H200: on another
# device the columns of ratios say nothing.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
out="" repeat=15 surfels_max=1000000 options=()
while [[ $# -gt 0 ]]; do
    case $1 in
        --out) out=$2; shift 2 ;;
        --repeat) repeat=$2; shift 2 ;;
        --surfels-max) surfels_max=$2; shift 2 ;;
        *) options+=("$1"); shift ;;
    esac
done
fail() { printf 'h200: %s\n' "$*" >&2; exit 1; }

find_program() {
    local candidate
    for candidate in "${RELIDAR:-}" "$here/../../bin/relidar" "$here/../../build/release/tools/relidar/relidar" "$(command -v relidar || true)"; do
        [[ -n $candidate && -x $candidate ]] && { printf '%s\n' "$candidate"; return; }
    done
    fail "no program: looked for \$RELIDAR, bin/relidar of a bundle and build/release; build it or unpack the bundle"
}
relidar=$(find_program)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
[[ -n $out ]] || out=$scratch/json
mkdir -p "$out"

# Median of a kernel or phase in a bench JSON (one key a line); 0 where it did not run. Arguments: file, pattern of names, summed.
median() {
    awk -v name="^ *\"($2)\": [{]" '$0 ~ name {inside = 1} inside && /"median":/ {gsub(/[^0-9.e+-]/, "", $2); sum += $2; inside = 0} END {printf "%.3f", sum}' "$1"
}
number() { awk -v name="^ *\"$2\":" '$0 ~ name {gsub(/[",]/, "", $2); print $2; exit}' "$1"; }

# scene surfels rays | build forward backward iteration MiB of the peer
readonly kPeer="
A 100000 waymo 3.2 12.2 16.1 36.1 1195
A 100000 kitti 3.3 8.8 11.2 27.2 1199
A 400000 waymo 6.9 76.7 83.7 178 1967
A 400000 kitti 6.3 53.1 56.2 119 1977
A 1000000 waymo 12.5 240 247 500 3523
A 1000000 kitti 13.2 168 175 357 3519
B 400000 waymo 6.0 17.0 20.6 46.7 1965
B 400000 kitti 5.9 12.8 15.0 38.9 1957
B 1000000 waymo 12.4 21.4 25.1 64.2 3547
B 1000000 kitti 12.3 15.6 18.3 51.9 3499
C 400000 waymo 6.1 10.2 13.6 33.3 1965"

# Every kernel and phase of a bench JSON: median, floor and their ratio.
kernels() {
    awk '/^ "(kernels|phases)_ms": [{]/ {inside = 1; next} /^ [}]/ {inside = 0}
         inside && /": [{]$/ {gsub(/[":{ ]/, ""); name = $0}
         inside && /"(median|floor|median_over_floor)":/ {gsub(/[",:]/, ""); value[$1] = $2}
         inside && /^  [}]/ {
             if (value["floor"] == "null") printf "%-22s %10.3f %10s %8s\n", name, value["median"], "-", "-"
             else printf "%-22s %10.3f %10.4f %8.1f\n", name, value["median"], value["floor"], value["median_over_floor"]
         }' "$1"
}

"$relidar" devices
if command -v nvidia-smi >/dev/null; then nvidia-smi -L; fi
printf '\nmilliseconds, median of %s; peer / ours; iteration = one training step on all rays\n' "$repeat"
printf '%-5s %9s %-6s | %14s %9s | %15s | %15s | %15s | %13s | %6s\n' scene surfels rays build refit forward backward iteration "memory MiB" hits
largest_A="" largest_B=""
while read -r scene surfels rays build forward backward iteration memory; do
    [[ -n $scene && $surfels -le $surfels_max ]] || continue
    file=$out/${scene}_${surfels}_${rays}.json
    "$relidar" bench --scene "$scene" --surfels "$surfels" --rays "$rays" --chunk "${CHUNK:-64}" --sh surfel --repeat "$repeat" --json "$file" --quiet "${options[@]}" \
        || { printf '%-5s %9s %-6s | failed\n' "$scene" "$surfels" "$rays"; continue; }
    if [[ $rays == waymo && $scene == A ]]; then largest_A=$file; fi
    if [[ $rays == waymo && $scene == B ]]; then largest_B=$file; fi
    peak=$(awk -v bytes="$(number "$file" peak_bytes)" 'BEGIN {printf "%.0f", bytes / 1048576}')
    printf '%-5s %9s %-6s | %6s %7s %9s | %6s %8s | %6s %8s | %6s %8s | %5s %7s | %6.1f\n' "$scene" "$surfels" "$rays" "$build" "$(median "$file" rebuild)" \
        "$(median "$file" 'accel/.*refit.*|accel/proxies')" "$forward" "$(median "$file" forward/trace)" "$backward" "$(median "$file" backward/trace)" \
        "$iteration" "$(median "$file" iteration)" "$memory" "$peak" "$(number "$file" hits_per_ray)"
done <<<"$kPeer"

for file in "$largest_B" "$largest_A"; do
    [[ -n $file ]] || continue
    printf '\n%-22s %10s %10s %8s   (%s; a copy moves %s GB/s)\n' kernel 'median ms' 'floor ms' ratio "$(basename "$file" .json)" "$(awk -v rate="$(number "$file" copy_bytes_per_s)" 'BEGIN {printf "%.1f", rate / 1e9}')"
    kernels "$file"
done

# The whole training program at KITTI size: wall clock of real steps, scaled to the paper's 30 000.
file=$out/B_400000_kitti.json
[[ ! -e $file ]] || awk -v wall="$(median "$file" iteration_wall)" 'BEGIN {printf "\n30 000 iterations at KITTI size (B 400k, 66 x 1030, wall clock of an iteration %.2f ms): %.1f minutes; the peer 30 to 50; aim 3\n", wall, wall * 30000 / 60000}'
printf '\nwall time %d s\n' "$SECONDS"
