#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests `relidar train --blocks` on a small synthetic street. The run must be usable like
# any other run. After any interruption, --resume must continue the training with
# bit-identical results. This also holds if mpirun distributes the blocks over processes,
# and if a device is lost. Processes that share frames must render and score the same as
# one process.
#
#   blocks_test.sh RELIDAR [WORK_FOLDER] [LAYER_FOLDER] [MPIRUN]
#
# LAYER_FOLDER: folder with the manifest of the layer that loses the device
# (device_loss/).
#
# Exits 77 (skipped) if there is no Vulkan device, or fails if RELIDAR_REQUIRE_GPU=1.
set -uo pipefail
relidar=$(realpath "${1:?usage: blocks_test.sh RELIDAR [WORK_FOLDER] [LAYER_FOLDER] [MPIRUN]}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
work=${2:-$(mktemp -d)}
layers=${3:+$(realpath "$3")}
mpirun=${4:-}
rm -rf "$work" && mkdir -p "$work" && work=$(realpath "$work") && cd "$work" || exit 1
source "$tests/checks.sh"

# Settings with which training on this street takes seconds and is deterministic.
settings=(--preset quick --set train.iterations=6 --set train.log_every=1 --set train.deterministic=true
    --set refine.enabled=false --set dataset.test_every=6 --set train.checkpoint_minutes=1e-9 --set init.voxel_m=0.3)

# same RUN: RUN must equal `one` bit by bit.
same() {
    local file
    for file in model.safetensors scene.json coverage.safetensors intensity_scatter.safetensors blocks/000/model.safetensors blocks/001/model.safetensors blocks/002/model.safetensors; do
        check "$1/$file differs from one/$file" cmp -s "one/$file" "$1/$file"
    done
}

# wait_for FILE: waits until the file exists, for at most a minute.
wait_for() {
    for _ in $(seq 600); do
        [[ ! -e $1 ]] || return 0
        sleep 0.1
    done
    fail "$1 never came"
}

wrong_lengths() {
    bad 2 "blocks.length_m.*\"sixty\"" train street --out x --blocks sixty
    absent x
}

whole() {
    good train street --out one --blocks 30m "${settings[@]}"
    says "^blocks  3 .* 26.[0-9] m .* 40 m"
    says "^block   3 of 3, .* 53 .* 79: "
    for file in report.html metrics.json log.jsonl blocks/002/scene.json; do exists one/$file; done
    absent one/blocks/000/checkpoints
    check "log.jsonl does not have each iteration once" diff <(seq 1 6) <(grep -o '"iteration":[0-9]*' one/log.jsonl | cut -d: -f2)
    good info one
    says "^blocks .* 3 "
    good info one/blocks/001   # a block can be used as a run
    good render one --out scans --frames 28:31
    good edit one --out edited --remove 0
    good render edited --out edited_scans --frames 30:31
    good export one --out one.ply
    local surfels blocks
    surfels=$(grep -a -m1 '^element vertex' one.ply | cut -d' ' -f3)
    blocks=$("$relidar" info one | sed -n 's/^surfels  *\([0-9]*\).*/\1/p')
    check "one.ply has $surfels surfels, info says $blocks" test "$surfels" = "$blocks"
    good train --resume one
    says "finished"
    bad 2 "one: .*contains" train street --out one --blocks 30m
}

# Interrupted in the second block and killed in the third.
stopped() {
    "$relidar" train street --out stopped --blocks 30m "${settings[@]}" --set train.iterations=100000 --quiet 2>err &
    local pid=$!
    wait_for stopped/blocks/000/checkpoints
    kill -INT $pid
    ends 130 "an interrupted training"
    check "the message does not say how to go on" grep -Eq "block 1 of 3: .* [0-9]+ of 100000; .*--resume stopped" err
    absent stopped/scene.json
    rm -rf stopped

    "$relidar" train street --out stopped --blocks 30m "${settings[@]}" --quiet 2>err &
    pid=$!
    wait_for stopped/blocks/001/checkpoints
    kill -KILL $pid
    wait $pid 2>/dev/null
    local first
    first=$(stat -c %Y stopped/blocks/000/model.safetensors)
    bad 3 "blocks/000 .*loss.depth = .*0.3" train --resume stopped --set loss.depth=0.3
    flock --no-fork stopped/.lock sleep 1 &   # simulates a process of the previous job that has not ended yet
    while flock --nonblock stopped/.lock true; do sleep 0.05; done
    good train --resume stopped
    check "the block that was complete was trained again" test "$first" = "$(stat -c %Y stopped/blocks/000/model.safetensors)"
    same stopped

    rm -rf stopped
    "$relidar" train street --out stopped --blocks 30m "${settings[@]}" --quiet 2>err &
    pid=$!
    # waits for scene.json; within half a second, the program then aligns held-out scans
    while kill -0 $pid 2>/dev/null && [[ ! -e stopped/scene.json ]]; do :; done
    kill -INT $pid
    ends 130 "interrupted behind its training"
    check "the message does not say what was interrupted" grep -Eq "relidar .*--resume stopped$" err
    absent stopped/report.html
    good train --resume stopped
    same stopped
    # trains without blocks, so the blocks of the previous run must be removed
    good train street --out stopped --force "${settings[@]}" --no-eval
    absent stopped/blocks
}

losing=(env VK_INSTANCE_LAYERS=VK_LAYER_RELIDAR_device_loss "VK_ADD_LAYER_PATH=$layers")

# At the start of a block, and between two iterations. Finished blocks must remain.
lost_device() {
    local after resume
    for after in 10 220; do
        resume='.*'
        [[ $after == 10 ]] || resume=".*; .*relidar train --resume gone"
        "${losing[@]}" RELIDAR_LOSE_DEVICE_AFTER=$after "$relidar" train street --out gone --force --blocks 30m "${settings[@]}" --quiet >out 2>err
        check "device lost after $after submissions: exit code $?, expected 4" test $? = 4
        check "the message lacks the driver's answer" grep -Eq "^relidar: block 1 of 3: .*VK_ERROR_DEVICE_LOST$resume" err
        check "more than one line" test "$(wc -l <err)" = 1
        absent gone/scene.json
        [[ $after != 10 ]] || absent gone
    done
    exists gone/blocks/000/checkpoints
    good train --resume gone
    same gone
}

mpi() { "$mpirun" --allow-run-as-root --oversubscribe -n "$@"; }

# mpi_pair FIRST... -- SECOND...: runs two processes with different commands. Does not use
# the colon of mpirun, because it crashes in Open MPI 5.0.7.
mpi_pair() {
    local first=()
    while [[ $1 != -- ]]; do
        first+=("$1")
        shift
    done
    shift
    printf '#!/bin/bash\n[[ $OMPI_COMM_WORLD_RANK != 0 ]] || exec %s\nexec %s\n' "${first[*]@Q}" "${*@Q}" >pair
    chmod +x pair
    mpi 2 ./pair
}

# Two processes share the blocks. tools/dev/kill_test kills one of them.
ranks() {
    mpi 2 "$relidar" train street --out two --blocks 30m "${settings[@]}" >out 2>err
    check "mpirun: exit code $?, expected 0" test $? = 0
    check "more than one process talks" test "$(grep -c '^blocks  3 blocks of' out)" = 1
    same two
    mpi 2 "$relidar" train street --out piece "${settings[@]}" >out 2>err
    check "a log in one piece by two processes: exit code 0" test $? != 0
    check "the message lacks --blocks" grep -Eq "2 MPI processes .*--blocks" err

    if [[ -n $layers ]]; then
        mpi_pair "$relidar" train street --out unplugged --blocks 30m "${settings[@]}" -- "${losing[@]}" RELIDAR_LOSE_DEVICE_AFTER=150 \
            "$relidar" train street --out unplugged --blocks 30m "${settings[@]}" >out 2>err
        check "a process whose device is lost: exit code $?, expected 4" test $? = 4
        check "the message lacks the driver's answer" grep -Eq "^relidar: block . of 3: .*VK_ERROR_DEVICE_LOST" err
        absent unplugged/scene.json
        mpi 2 "$relidar" train --resume unplugged >out 2>err
        check "resumed with two devices again: exit code $?, expected 0" test $? = 0
        same unplugged
    fi
}

# mpirun must end with the exit code of the failed process, and --resume must continue.
misfits() {
    cp "$relidar" other && printf x >>other
    mpi_pair "$relidar" train street --out misfit --blocks 30m "${settings[@]}" -- ./other train street --out misfit --blocks 30m "${settings[@]}" >out 2>err
    check "two builds: exit code $?, expected 2" test $? = 2
    check "the message lacks the build" grep -Eq "process 1 .*build" err
    # mpirun may end before a process that it has terminated
    [[ ! -d misfit ]] || flock -w 20 misfit/.lock true
    mpi_pair "$relidar" train street --out misfit --force --blocks 30m "${settings[@]}" -- "$relidar" train street --out misfit --force --blocks 30m "${settings[@]}" --device 99 >out 2>err
    check "a device that one process lacks: exit code $?, expected 4" test $? = 4
    check "the message lacks the device" grep -Eq "^relidar: .*device 99: " err
    absent misfit/scene.json
    mpi 2 "$relidar" train --resume misfit street --blocks 30m "${settings[@]}" >out 2>err
    check "resumed after a device failed: exit code $?, expected 0" test $? = 0
    same misfit

    # returns if this user may not mount
    mkdir -p full && mount -t tmpfs -o size=2500k tmpfs full 2>/dev/null || return 0
    # A partial checkpoint would use the space of the first model.
    mpi 2 "$relidar" train street --out full/run --blocks 30m "${settings[@]}" --set train.checkpoint_minutes=10 --quiet >out 2>err
    check "a full folder: exit code $?, expected 3" test $? = 3
    check "the message lacks the block" grep -Eq "^relidar: block . of 3: .*: No space left on device; .*--resume full/run" err
    absent full/run/scene.json
    # no files of the first block may remain
    check "nothing is kept in the full folder" compgen -G "full/run/blocks/*/scene.json" >/dev/null
    mount -o remount,size=64m full
    mpi 2 "$relidar" train --resume full/run >out 2>err
    check "resumed with room again: exit code $?, expected 0" test $? = 0
    check "the blocks of a folder that was full differ" cmp -s one/blocks/002/model.safetensors full/run/blocks/002/model.safetensors
    umount -l full
}

# Prints the scores of frames in metrics.json without times.
scores() { sed '/"timings"/,$d' "$1" | grep -v '"trace_ms"'; }

# Processes that share frames must write the same files and scores as one process.
frames() {
    printf '{"sensors": [{"name": "left", "sensor": "VLP-16", "translation_m": [0, 1, 0]}, {"name": "right", "sensor": "VLP-16", "translation_m": [0, -1, 0]}]}' >rig.json
    local how
    for how in "--frames all --format npz,ply" "--frames 28:30" "--frames 20:25 --sensor rig.json" "--frames 20:25 --sensor rig.json --merge"; do
        rm -rf alone together
        # shellcheck disable=SC2086
        good render one --out alone $how --quiet
        # shellcheck disable=SC2086
        mpi 3 "$relidar" render one --out together $how >out 2>err
        check "mpirun render $how: exit code $?, expected 0" test $? = 0
        check "more than one process talks" test "$(wc -l <out)" = 1
        says "of 3 processes"
        check "render $how: three processes write other files than one" diff -r alone together
    done
    mpi 2 "$relidar" render one --out together --frames 20:25 >out 2>err
    check "two processes overwrite a rendering" test $? != 0
    check "the message lacks --force" grep -Eq "contains.*--force" err
    exists together/frame_000020.npz
    mpi 2 "$relidar" render one --out together --frames 20:25 --force --quiet >out 2>err
    check "render --force by two processes: exit code $?, expected 0" test $? = 0
    mpi 2 "$relidar" render one --out film --format mcap >out 2>err
    check "two processes write one recording" test $? != 0
    check "the message lacks mcap" grep -Eq -- "--format mcap: .* 2 MPI" err
    absent film

    good eval one --out alone.json --baseline nearest --pictures alone_pictures --quiet
    mpi 3 "$relidar" eval one --out together.json --baseline nearest --pictures together_pictures >out 2>err
    check "mpirun eval: exit code $?, expected 0" test $? = 0
    check "more than one process talks" test "$(grep -c 'held-out frames' out)" = 1
    check "three processes find other scores than one" diff <(scores alone.json) <(scores together.json)
    check "three processes draw other pictures than one" diff -r alone_pictures together_pictures
    good eval street --out alone.json --baseline nearest --quiet
    mpi 2 "$relidar" eval street --out together.json --baseline nearest --quiet >out 2>err
    check "two processes find another baseline than one" diff <(scores alone.json) <(scores together.json)
    mpi 2 "$relidar" eval one --open >out 2>err
    check "--open by two processes: exit code 0" test $? != 0
}

mkdir street && printf 'seed = 5\nn_frames = 60\nrows = 8\ncolumns = 96\nspeed_mps = 13.4\n' >street/street.toml
wrong_lengths
if "$relidar" list devices >/dev/null 2>&1; then
    whole
    stopped
    if [[ -n $layers ]]; then lost_device; fi
    if [[ -n $mpirun ]]; then ranks; misfits; frames; fi
elif [[ ${RELIDAR_REQUIRE_GPU:-0} == 1 ]]; then
    fail "no Vulkan device"
else
    skipped=1
fi
finish_checks
