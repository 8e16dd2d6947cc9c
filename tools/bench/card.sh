#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests and measures a GPU: runs the test suites, measures every kernel against the tracer
# of the paper and against its lower bound, and runs a training. Works in a source tree or
# inside the bundle (tools/dev/bundle --tests). Needs only bash and awk.
#
#   tools/bench/card.sh [--out DIR] [--minutes N] [--only PART] [--repeat N] [--surfels-max N]
#                       [relidar options, such as --device 0]
#
# PART is suites, bench or demo, for machines that are available for only a few minutes. A
# step that fails or takes too long is reported with the found and expected values, and
# the next step starts. The last output is a summary; the exit code is 1 if a step failed.
# RELIDAR=FILE and RELIDAR_DEV=FILE select the programs, RELIDAR_TESTS=DIR the folder of
# the suites. DIR receives the logs and the JSON of every case. The numbers of the other
# tracer were measured on an NVIDIA H200, so on another device the ratios have no meaning.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
out="" minutes=25 only="" repeat=15 surfels_max=1000000 options=()
while [[ $# -gt 0 ]]; do
    case $1 in
        --out) out=$2; shift 2 ;;
        --minutes) minutes=$2; shift 2 ;;
        --only) only=$2; shift 2 ;;
        --repeat) repeat=$2; shift 2 ;;
        --surfels-max) surfels_max=$2; shift 2 ;;
        *) options+=("$1"); shift ;;
    esac
done
fail() { printf 'card: %s\n' "$*" >&2; exit 1; }
[[ -z $only || $only =~ ^(suites|bench|demo)$ ]] || fail "--only: found \"$only\", expected suites, bench or demo"
wants() { [[ -z $only || $only == "$1" ]]; }
deadline=$(awk -v minutes="$minutes" 'BEGIN {printf "%d", minutes * 60}')

# Prints the first of the given paths that exists, or nothing.
first_of() {
    local candidate
    for candidate; do
        [[ -z $candidate || ! -e $candidate ]] || { printf '%s\n' "$candidate"; return; }
    done
}
relidar=$(first_of "${RELIDAR:-}" "$here/../../bin/relidar" "$here/../../build/release/tools/relidar/relidar" "$(command -v relidar || true)")
[[ -n $relidar ]] || fail "found no program relidar in \$RELIDAR, in bin of a bundle or in build/release; build it or unpack the bundle"
relidar_dev=$(first_of "${RELIDAR_DEV:-}" "$here/../../tests/bin/relidar-dev" "$here/../../build/ci/tools/relidar_dev/relidar-dev")
[[ -n $relidar_dev || $only == suites ]] || fail "found no program relidar-dev in \$RELIDAR_DEV, in tests/bin of a bundle or in build/ci; build preset ci, or make the bundle with --tests"
tests=$(first_of "${RELIDAR_TESTS:-}" "$here/../../tests/bin" "$here/../../build/ci/tests")
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
[[ -n $out ]] || out=$scratch/out
mkdir -p "$out"

# Prints the failures in a log with their numbers: all lines of each failed assertion of a
# suite, or the error message of the program.
findings() {
    printf '\n'
    grep -E 'Failure|FAILED|^Expected|actual:|^The difference|evaluates to|^Which is|relidar:|terminate|validation:' "$1" |
        cut -c 1-200 | head -n 40 | sed 's/^/    /' || true
}

summary=() failed=0
# step <name> <most seconds> <command...>: writes the output of a command to a log and its
# result to the summary. Returns the exit code of the command.
step() {
    local name=$1 limit=$2 rc=0 start=$SECONDS left=$((deadline - SECONDS)) result=ok
    shift 2
    [[ $limit -le $left ]] || limit=$left
    if [[ $limit -lt 5 ]]; then
        summary+=("$(printf '%-24s not run, because no time is left' "$name")")
        return 1
    fi
    timeout "$limit" "$@" >"$out/$name.log" 2>&1 || rc=$?
    if [[ $rc -eq 124 ]]; then result="stopped after the time limit of $limit s"
    elif [[ $rc -ne 0 ]]; then result="FAILED, exit code $rc"; fi
    [[ $rc -eq 0 ]] || failed=1
    summary+=("$(printf '%-24s %4d s  %s' "$name" $((SECONDS - start)) "$result"; [[ $rc -eq 0 ]] || findings "$out/$name.log")")
    printf '%s\n' "${summary[-1]}" >&2
    return "$rc"
}

# Runs the suites that use the device, once for each of its traversals. Arguments:
# NAME:SECONDS with the maximum duration of each suite.
suites() {
    local suite limit traversal
    [[ -n $tests ]] || { summary+=("suites: not run, no tests beside the program (tools/dev/bundle --tests, or build preset ci)"); return 0; }
    for suite; do
        limit=${suite#*:} suite=${suite%:*}
        for traversal in "${traversals[@]}"; do
            [[ -x $tests/${suite}_test ]] || continue
            RELIDAR_REQUIRE_GPU=1 RELIDAR_TEST_TRAVERSAL=$traversal step "${suite}_$traversal" "$limit" "$tests/${suite}_test" --gtest_brief=1 || true
        done
    done
}

# Prints the median of a kernel or phase in a benchmark's JSON (one key per line), or 0 if
# it did not run. Arguments: file, pattern of the names that are summed.
median() {
    awk -v name="^ *\"($2)\": [{]" '$0 ~ name {inside = 1} inside && /"median":/ {gsub(/[^0-9.e+-]/, "", $2); sum += $2; inside = 0} END {printf "%.3f", sum}' "$1"
}
number() { awk -v name="^ *\"$2\":" '$0 ~ name {gsub(/[",]/, "", $2); print $2; exit}' "$1"; }

# Results of the other tracer. Columns: scene, surfels, rays, times in ms (build, forward,
# backward, iteration), and memory in MiB.
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

"$relidar" list devices | tee "$out/devices.txt"
traversals=(software)
if "$relidar" list devices --json | grep -q '"ray_query": true'; then traversals+=(ray_query); fi
if wants suites; then suites traversal:60 accel:60 forward:60 backward:200; fi

# Measures the speed of every kernel.
bench() {
    local scene surfels rays build forward backward iteration memory file peak largest_A="" largest_B="" chunk walk
    if command -v nvidia-smi >/dev/null; then nvidia-smi -L; fi
    printf '\nmilliseconds, median of %s repetitions; reference implementation / relidar; iteration: a training step on all rays\n' "$repeat"
    printf '%-5s %9s %-6s | %14s %9s | %15s | %15s | %15s | %13s | %6s\n' scene surfels rays build refit forward backward iteration "memory MiB" hits
    while read -r scene surfels rays build forward backward iteration memory; do
        [[ -n $scene && $surfels -le $surfels_max ]] || continue
        file=$out/${scene}_${surfels}_${rays}.json
        step "bench_${scene}_${surfels}_$rays" 60 "$relidar_dev" bench --scene "$scene" --surfels "$surfels" --rays "$rays" --chunk "${CHUNK:-64}" --sh surfel --repeat "$repeat" --json "$file" "${options[@]}" \
            || { printf '%-5s %9s %-6s | failed\n' "$scene" "$surfels" "$rays"; continue; }
        if [[ $rays == waymo && $scene == A ]]; then largest_A=$out/bench_${scene}_${surfels}_$rays.log; fi
        if [[ $rays == waymo && $scene == B ]]; then largest_B=$out/bench_${scene}_${surfels}_$rays.log; fi
        peak=$(awk -v bytes="$(number "$file" peak_bytes)" 'BEGIN {printf "%.0f", bytes / 1048576}')
        printf '%-5s %9s %-6s | %6s %7s %9s | %6s %8s | %6s %8s | %6s %8s | %5s %7s | %6.1f\n' "$scene" "$surfels" "$rays" "$build" "$(median "$file" rebuild)" \
            "$(median "$file" 'accel/.*refit.*|diff/accel/bvh_refit|diff/accel/proxies')" "$forward" "$(median "$file" "diff/forward/.*")" "$backward" "$(median "$file" diff/backward/trace)" \
            "$iteration" "$(median "$file" iteration)" "$memory" "$peak" "$(number "$file" hits_per_ray)"
    done <<<"$kPeer"

    for file in "$largest_B" "$largest_A"; do
        [[ -z $file ]] || cat "$file"
    done

    # The complete training program at KITTI size: wall time of real steps, scaled to the
    # paper's 30,000 steps.
    file=$out/B_400000_kitti.json
    [[ ! -e $file ]] || awk -v wall="$(median "$file" iteration_wall)" 'BEGIN {printf "\n30 000 iterations at KITTI size (B 400k, 66 x 1030, wall clock of an iteration %.2f ms): %.1f minutes; reference implementation 30 to 50 minutes; goal 3 minutes\n", wall, wall * 30000 / 60000}'

    # Measures the forward and backward pass of the two largest cases, for several chunk
    # sizes and with a lane or a subgroup per ray (--walk).
    printf '\n%-30s %12s %12s   (ms)\n' 'chunk, walk' 'forward' 'backward'
    for scene in B A; do
        for chunk in 16 32 64; do
            for walk in lane subgroup; do
                file=$out/${scene}_chunk${chunk}_$walk.json
                step "bench_${scene}_chunk${chunk}_$walk" 40 "$relidar_dev" bench --scene "$scene" --surfels "$surfels_max" --rays waymo --chunk "$chunk" --walk "$walk" --traversal software --sh surfel \
                    --repeat 7 --json "$file" --quiet "${options[@]}" || continue
                printf '%-30s %12s %12s\n' "$scene $surfels_max, $chunk, $walk" "$(median "$file" "diff/forward/.*")" "$(median "$file" diff/backward/trace)"
            done
        done
    done
}
if wants bench; then bench; fi

if wants suites; then suites gpu:60 scene:90 loss:60 optimizer:60 densify:90 refine:90 render:60 train:400; fi
if wants demo; then
    step demo 150 "$relidar" demo --out "$out/demo" "${options[@]}" && tail -n 30 "$out/demo.log" || true
    # Measures the scans per second of a simulation, with one scan and with several scans
    # at a time, and the kernels of a training step.
    for part in "scans --scans 200" "together --scans 200 --together 4" "steps --steps 50"; do
        [[ -d $out/demo/run ]] || continue
        read -r -a words <<<"$part"
        name=run_${words[0]}
        step "$name" 60 "$relidar_dev" bench --run "$out/demo/run" "${words[@]:1}" "${options[@]}" &&
            tail -n 40 "$out/$name.log" || true
    done
    rm -rf "$out/demo"   # Removes the scans and pictures. The table is in the log.
fi

printf '\nsummary\n'
printf '%s\n' "${summary[@]}" | tee "$out/summary.txt"
printf 'wall time %d s\n' "$SECONDS"
exit "$failed"
