#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests the command line tool like a user: every command on a tiny synthetic street. Every
# invalid input must give a one-line message and the correct exit code.
#
#   cli_test.sh RELIDAR [WORK_FOLDER]
#
# Exits 77 (skipped) if there is no Vulkan device, or fails if RELIDAR_REQUIRE_GPU=1.
set -uo pipefail
relidar=$(realpath "${1:?usage: cli_test.sh RELIDAR [WORK_FOLDER]}")
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")")
work=${2:-$(mktemp -d)}
rm -rf "$work" && mkdir -p "$work" && cd "$work" || exit 1
source "$tests/checks.sh"

help_tells() {
    good --help
    commands="list convert info train refine render serve edit assets view eval export check demo"
    for command in $commands; do says "^  $command "; done
    check "relidar --help is longer than a screen of 24 lines" test "$(wc -l <out)" -lt 24
    check "relidar --help is wider than 80 columns" test "$(wc -L <out)" -le 80
    # the two additional lines are examples
    check "relidar --help lists other commands" test "$(grep -Ec '^  [a-z]+ +[a-z]' out)" = $(($(wc -w <<<"$commands") + 2))
    for command in $commands "list devices" "list sensors" "list settings"; do
        # shellcheck disable=SC2086
        good $command --help
        says "Example"
    done
    good --version
    says "^relidar [0-9]+\.[0-9]+"
    good list settings --preset paper
    says "^iterations = 30000$"
    good list settings --preset released
    says '^preset = "released"$'
    says "^# [0-9]+ expert"
    check "an expert setting is shown" test -z "$(grep '^box = ' out)"
    good list settings --set loss.box=0.5
    says "^box = 0.5$"
    good list settings --preset released --all
    says "^box = 0.01[0-9]*$"
    says "^intensity_ssim = 0.15[0-9]*$"
}

wrong_usage() {
    bad 2 "command"
    bad 2 "trian.*train" trian
    bad 2 "--sed,.* --" train street --out x --sed 1
    bad 2 "DATASET" train
    bad 2 "out .*--resume" train street
    bad 2 "DATASET .* nowhere .*config.toml" train --resume nowhere
    bad 2 "out .*--resume" train --resume
    bad 2 "extra" info street extra
    bad 2 'loss.depth: .*"abc"' train street --out x --set loss.depth=abc
    bad 2 '--set: .*"loss.depth".* KEY=VALUE' train street --out x --set loss.depth
    bad 2 'train.seed: .*"-1"' train street --out x --seed -1
    bad 2 '--device: .*"x"' train street --out x --device x
    bad 2 'traversal: .*"x".*auto' train street --out x --traversal x
    bad 2 "dataset.sequence: .*kd1" info street --sequence kd1
    bad 2 "lidar: .*rear" info street --set dataset.lidars=rear
    bad 2 'empty .*"5:5"' train street --out x --frames 5:5
    bad 2 'FIRST:END' train street --out x --frames 5
    bad 3 "missing.toml: " train street --out x --config missing.toml
    printf '[loss]\ndepth = \n' >broken.toml
    bad 3 "broken.toml:2: .*TOML" list settings --config broken.toml
    bad 3 "nowhere: " info nowhere
    bad 3 "dataset" info .
    bad 2 "kind 'kity'" info kity:street
    bad 3 "folder .*broken.toml/run" train street --out broken.toml/run
    bad 3 "/proc/" train street --out /proc/relidar
    mkdir full && printf 'x' >full/file
    bad 2 "full: .*empty" train street --out full --force
    bad 2 "street: .* log" train street --out street --force
    bad 2 "street: .* log" train street --out street --resume
    check "the log, or what was beside no run, was touched" test -s street/street.toml -a -s full/file -a "$(ls -A street full | wc -l)" = 5
    bad_paths
    bad 3 "nowhere: " render nowhere --out x
    bad 3 "nowhere: " eval nowhere
    bad 2 'baseline: .*"nerest".*nearest-actors' eval street --baseline nerest
    bad 3 "nowhere: " eval nowhere --baseline nearest
    bad 3 "street: .*held-out" eval street --baseline nearest --frames 0:5
    bad 2 "open: .*log" eval street --baseline nearest --open
    bad 3 "nowhere: " export nowhere --out x.ply
    bad 2 "x.obj: .*\.obj, .*\.ply" export run --out x.obj
    bad 2 'train.iterations: .*"-1"' demo --out x --set train.iterations=-1
    bad 3 "nowhere: " edit nowhere --from-ply scene.ply --out x
    bad 2 "subcommand.*devices, sensors, settings" list
    bad 2 "sensor, .*sensors" list sensor
    bad 2 "--jso, .*--json" list devices --jso
    bad 3 "--json .: .*folder" check --json .
    bad 3 "nowhere: " check --run nowhere
    absent x
}

# The commands run as "nobody", because root has all permissions.
bad_paths() {
    local own=$relidar
    mkdir locked && cp -r street unreadable && ln -s loop loop && printf 'elevation_deg\n0\n' >beams.csv
    if [[ $(id -u) == 0 ]] && command -v setpriv >/dev/null && setpriv --reuid=65534 --clear-groups test -x "$relidar" -a -x "$work"; then
        printf '#!/bin/sh\nexec setpriv --reuid=65534 --clear-groups %q "$@"\n' "$relidar" >as_nobody && chmod 755 as_nobody && relidar=$work/as_nobody
    fi
    chmod 000 locked unreadable/street.toml beams.csv
    local long
    long=$(printf 'x%.0s' {1..300})
    if [[ $(id -u) != 0 || $relidar != "$own" ]]; then
        # shellcheck disable=SC2086  # A command and its options are several words.
        for command in "train street" "demo" "render street" "edit run --remove 0" "edit run --from-ply a.ply"; do bad 3 "(locked|run).*(Permission denied|such folder|config.toml .*missing)" $command --out locked/run; done
        bad 3 "unreadable/street.toml: Permission denied" info unreadable
        bad 3 "locked.*: Permission denied" info locked
        bad 3 "locked/run: Permission denied" info locked/run
        bad 3 "beams.csv: Permission denied" info street --set dataset.poses=beams.csv
    fi
    relidar=$own
    for out in loop loop/run "$long" "a/$long"; do
        bad 3 "folder.*(Too many levels of symbolic links|File name too long)" train street --out "$out"
        bad 3 "folder.*(Too many levels of symbolic links|File name too long)" demo --out "$out"
    done
    bad 3 "(Too many levels of symbolic links|File name too long)" info loop
    bad 3 "File name too long" info "$long"
    chmod 755 locked && rm -rf locked unreadable loop beams.csv a as_nobody
}

no_driver() {
    for command in "list devices" "train street --out x" "demo --out x"; do
        # shellcheck disable=SC2086  # A command and its options are several words.
        VK_DRIVER_FILES=/nonexistent VK_ICD_FILENAMES=/nonexistent "$relidar" $command >out 2>err
        local code=$?
        check "relidar $command without a driver: exit code $code, expected 4" test "$code" = 4
        check "relidar $command without a driver: not one line" test "$(wc -l <err)" = 1
        check "relidar $command without a driver: the message names no driver" grep -q "driver" err
    done
    absent x
    echo '{"file_format_version": "1.0.1", "ICD": {"library_path": "./no_library.so", "api_version": "1.3.0"}}' >driver.json
    VK_DRIVER_FILES=$PWD/driver.json bad 4 "driver.json: .*cannot be loaded: .*/no_library.so" list devices
    rm driver.json
}

devices() {
    good list devices
    says "ray query"
    good list devices --json
    says '"traversal"'
    bad 4 "device 99" train street --out x --device 99
    bad 2 "50:60" train street --out x --frames 50:60
    absent x
}

log_info() {
    good info street --set init.actor_classes=Van
    says 'masked +0 \(Car\), 1 \(Car\)'
    good info street
    says "8 rows x 96 columns"
    says "12 \(0 to 11\)"
    says "^boxes +2: 2 moving, 0 parked$"
    good info street --frames 9:14
    check "frames beyond the log are left out without a word" grep -q "note: frames 9:14: .*frame 11" err
    good info synthetic:street --frames 2:5 --json
    says '"frames": 3'
    says '"returns_share": 0\.'
}

converting() {
    good convert street --out plain --frames 2:6
    says "plain: 4 scans of 1 LiDAR, 2 boxes$"
    for file in sequence.json poses.txt boxes.json scans/000002.npz scans/000005.npz; do exists plain/$file; done
    good info street --frames 2:6
    # The table of conventions says which file declares them.
    without_origin() { sed '/^source/d; /^convention  /,/^$/d' out; }
    without_origin >street.txt
    good info plain
    check "info says other things of a log and of the folder it was converted to" cmp -s street.txt <(without_origin)
    bad 2 "plain: .*--force" convert street --out plain
    good convert plain --out plain --frames 3:20 --force --quiet
    check "--quiet prints" test ! -s out -a ! -s err
    check "--force left scans of the log before" test "$(ls plain/scans | wc -l)" = 3
    bad 2 "street: .* new " convert street --out street --force
    good convert street --out free --set dataset.poses=none
    absent free/poses.txt
    bad 3 "free/poses.txt: " info free
    good info free --set dataset.poses=none
    bad 3 "nowhere: " convert nowhere --out x
    bad 2 "--out" convert street
    bad 3 "folder .*x" convert street --out street/street.toml/x
    printf 'seed = 5\nn_frames = 60\nrows = 32\ncolumns = 512\n' >long.toml && mkdir long && mv long.toml long/street.toml
    "$relidar" convert long --out stopped >out 2>err &
    local pid=$!
    until ls -d .stopped.tmp-* >/dev/null 2>&1 || ! kill -0 $pid 2>/dev/null; do sleep 0.05; done
    kill -TERM $pid
    ends 130 "interrupted convert"
    check "interrupted convert left something behind" test -z "$(ls -d stopped .stopped* 2>/dev/null)"
    rm -rf long
}

training() {
    good train street --out run --preset quick --set train.refine_poses=none --set init.actor_min_points=10 --set train.iterations=6 --set train.log_every=2 --set dataset.test_every=5 --seed 3
    says "^stages  .*train [0-9.]* s"
    check "log.jsonl does not end with the stages" grep -Eq '^\{"stages_s":\{"read":[0-9.e-]+,.*"train":' <(tail -n 1 run/log.jsonl)
    check "the report lacks the stages" grep -q "train [0-9.]* s" run/report.html
    for file in config.toml scene.json model.safetensors log.jsonl metrics.json report.html; do exists run/$file; done
    check "log.jsonl has other than 4 lines and the stages" test "$(wc -l <run/log.jsonl)" = 5
    check "config.toml lacks the seed" grep -qx "seed = 3" run/config.toml
    check "config.toml lacks the iterations" grep -qx "iterations = 6" run/config.toml
    check "progress lacks rate and remaining time" grep -Eq "^iteration 6/6  [0-9.]+ iterations/s .* 0:00 .* [0-9.e-]+ \(depth" err
    bad 2 "run: .*contains" train street --out run
    good train street --out again --config run/config.toml --set train.iterations=0 --no-eval --quiet
    check "--quiet prints" test ! -s out -a ! -s err
    absent again/metrics.json
    good train street --out again --config run/config.toml --set train.iterations=2 --no-eval --force
    good info run
    says "10 .* 2 .* \(5, 10\)"
    good info run --json
    says '"surfels": [1-9]'
}

# Sets the variable python to a Python with numpy, or to none.
find_numpy() {
    for python in python3 /usr/bin/python3 none; do "$python" -c 'import numpy' 2>/dev/null && break; done
}

# Writes data sets and compares them with the boxes of a rendering.
layouts() {
    local python layout view
    find_numpy
    good render run --out labelled "$@" --format bin --boxes
    # A small picture, because those of the default cameras take long.
    echo '{"K": [180, 0, 155, 0, 180, 43, 0, 0, 1], "size": [310, 94], "translation_m": [0.3, 0.1, -0.1], "yaw_pitch_roll_deg": [3, 1, 0]}' >camera.json
    for layout in kitti nuscenes openlabel custom; do
        view=(--camera camera.json --fov all)
        [[ $layout = kitti || $layout = nuscenes ]] || view=()
        good render run --out $layout "$@" --layout $layout "${view[@]}"
        says "wrote 2 scans .*$layout"
        bad 2 "$layout: sequence 0 .*--force" render run --out $layout "$@" --layout $layout "${view[@]}"
        [[ $layout = openlabel || $layout = custom ]] || view=(--camera none)
        good render run --out $layout "$@" --layout $layout --sample 1 "${view[@]}"
        [[ $layout = openlabel || $layout = custom ]] || view=(--camera camera.json --fov all)
        good render run --out $layout "$@" --layout $layout --force "${view[@]}"
        for file in README.md dataset.json; do exists $layout/$file; done
        if [[ $python != none ]]; then
            "$python" "$tests/read_layouts.py" $layout $layout 0 labelled packet_rig.json >err 2>&1 &&
                "$python" "$tests/read_layouts.py" $layout $layout 1 >err 2>&1
            check "read_layouts.py finds faults" test $? = 0
        fi
    done
    [[ $python = none ]] || "$python" "$tests/compare_layouts.py" kitti nuscenes custom --rig packet_rig.json >out 2>&1
    check "the layouts have different boxes" test $? = 0
    good info nuscenes   # one of two frames: the other is in the scene for validation
    says "^frames +2 "
    says "^boxes +[12]: "
    bad 2 "--layout openlabel: kitti " render run --out kitti --layout openlabel
    bad 2 " labelled/top" render run --out labelled/top --layout kitti
    bad 2 "--layout kitti: .*--format, --merge" render run --out x --layout kitti --deskew
    bad 2 "--layout kitti: .*--format, --merge" render run --out x --layout kitti --format npz
    bad 2 "--out kitti: this is a data set .*--layout, .*--force" render run --out kitti
    check "a data set has an absolute path" test "$(grep -rlIF "$PWD" kitti nuscenes openlabel labelled | wc -l)" = 0
    bad 2 '--layout: "kiti" .*openlabel' render run --out x --layout kiti
    bad 2 "--fov .*--layout" render run --out x --fov all
    bad 2 "--camera kitti: .*openlabel" render run --out x --layout openlabel --camera kitti
    bad 2 "--fov camera: .*openlabel" render run --out x --layout openlabel --fov camera
    absent x
}

# Files on a map of the earth, from a world that is turned by 45 degrees against it.
on_earth() {
    local python crs plane="+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lat_0=49.015 +lon_0=8.434 +h_0=116.4"
    printf '{"latitude_deg": 49.015, "longitude_deg": 8.434, "height_m": 116.4, "world_point_m": [3, 2, 1], "crs": "%s",
        "rotation": [0.9238795325112867, 0, 0, 0.3826834323650898]}' "$plane" >place.json
    bad 2 "--crs EPSG:32632: .*georeference" export run --out path.csv --crs EPSG:32632
    bad 2 "--latitudes: .*georeference" export run --out path.csv --latitudes
    good edit run --georeference place.json --out placed
    good info placed
    says "^on earth .*latitude 49\.015.*turned by 45\.00 degrees"
    if "$relidar" export placed --out latitudes.csv --latitudes 2>&1 | grep -q "without PROJ"; then
        echo "note: relidar was built without PROJ, positions on the earth are not tested"
        return
    fi
    for crs in EPSG:2263 EPSG:3857 EPSG:4978; do bad 3 "$crs" export placed --out path.csv --crs $crs; done
    bad 2 "--format npz" render placed --out x --crs EPSG:32632
    good export placed --points local.las
    check "nobody says that the las has no coordinate system" grep -q -- "--crs EPSG:32632" err
    find_numpy
    if [[ $python != none ]]; then
        good export placed --points local.ply
        good export placed --points utm.las --crs EPSG:32632
        good export placed --out path.csv
        good export placed --out utm.csv --crs EPSG:32632
        good render placed --out turned --format ply --frame world --channels normal --frames 2:4
        good render placed --out utm --format ply,las --crs EPSG:32632 --channels normal --frames 2:4
        "$python" "$tests/read_map.py" placed/scene.json local.ply utm.las path.csv utm.csv turned utm >err 2>&1
        check "read_map.py finds faults" test $? = 0
    fi
    good edit run --georeference latitudes.csv --out fitted
    good export fitted --out fitted.csv --crs EPSG:32632
    paste -d, utm.csv fitted.csv | awk -F, 'NR > 1 && (($2 - $9) ^ 2 + ($3 - $10) ^ 2 > 1e-4) { exit 1 }'
    check "the path that was fitted to its latitudes is elsewhere" test $? = 0
    printf 'time_s,latitude_deg,height_m\n0,49,0\n' >fixes.csv
    bad 3 "longitude_deg" edit run --georeference fixes.csv --out x
}

# Uses numpy and OpenEXR's tool, if they are installed.
foreign_readers() {
    local python
    find_numpy
    if [[ $python == none ]]; then
        echo "note: no numpy, npz, ply, pcd and bin are not read by another program"
    else
        good render run --out in_world --format npz,ply --frame world
        # In UTM coordinates, float32 has steps of 0.25 m; in those of the earth 0.5 m.
        good render run --out in_small --frames all --format npz --frame world --only background
        local shift
        for shift in "500000 4000000 100" "6378137 0 0"; do
            rm -rf mapped && cp -r run mapped
            "$python" -c 'import json, sys; s = json.load(open("mapped/scene.json")); s["world_offset_m"] = [a + float(b) for a, b in zip(s["world_offset_m"], sys.argv[1].split())]; json.dump(s, open("mapped/scene.json", "w"))' "$shift"
            good render mapped --out in_map --frames all --format npz,ply,pcd,bin,las --frame world --only background --force
            good export mapped --points map.las
            # shellcheck disable=SC2086
            "$python" "$tests/read_world.py" in_small in_map $shift map.las >err 2>&1
            check "read_world.py finds faults" test $? = 0
        done
        bad 2 "--points map.xyz: " export mapped --points map.xyz
        bad 2 "--spacing" export mapped --points map.las --spacing 0
        bad 2 "--out or --points" export mapped
        good render run --out deskewed --format npz,ply --deskew
        "$python" "$tests/read_scans.py" scans in_world deskewed >err 2>&1
        check "read_scans.py finds faults" test $? = 0
        good render run --out with_normals --format npz,ply,pcd,bin --channels normal,spread
        "$python" "$tests/read_scans.py" with_normals >err 2>&1
        check "read_scans.py finds faults with normals and spread" test $? = 0
    fi
    if ! command -v exrheader >/dev/null; then
        echo "note: no exrheader, exr is not read by another program"
    else
        good render run --out spread --frames 5:6 --format exr --channels spread
        exrheader spread/frame_000005.exr >out 2>err
        says '^    spread, 32-bit floating-point'
        exrheader scans/frame_000005.exr >out 2>err
        check "exrheader refuses the file" test $? = 0
        check "an exr has a spread that was not asked for" test "$(grep -c spread out)" = 0
        says '^sensor \(type string\): "synthetic"$'
        says '^time_s \(type string\): "0.5"$'
        says '^    median_range, 32-bit floating-point'
    fi
}

rendering() {
    good render run --out scans --format npz,exr,ply,pcd,bin,png
    for frame in 000005 000010; do
        for format in npz exr ply pcd bin png; do exists scans/frame_$frame.$format; done
    done
    check "render wrote other than 12 files and scans.json" test "$(ls scans | wc -l)" = 13
    foreign_readers
    flock --no-fork scans/.lock sleep 60 &   # simulates a process that is writing the folder
    local writer=$!
    while flock --nonblock scans/.lock true; do sleep 0.05; done
    bad 3 "scans: .*process" render run --out scans --force
    bad 3 "scans: .*process" export run --out scans --frames 2:3
    kill -KILL $writer
    wait $writer 2>/dev/null
    bad 2 "scans: .*\(13 .*--force" render run --out scans --frames 2:3
    printf 'mine' >scans/frame_notes.txt
    good render run --out scans --frames 2:3 --format NPZ --force
    check "--force removed a file of the user's" grep -qx mine scans/frame_notes.txt
    rm scans/frame_notes.txt
    check "--force left frames of the rendering before" test "$(ls scans | tr '\n' ' ')" = "frame_000002.npz scans.json "
    good render run --out recorded --frames 2:4 --format mcap,rosbag
    check "recordings are other than one file each" test "$(ls -A recorded | tr '\n' ' ')" = "rosbag.mcap scans.json scans.mcap "
    check "recordings that begin after 0 s have other times than the log" test "$(grep -c "^relidar: note: .* 1 s " err)" = 0
    bad 2 "--out run: .*folder" render run --out run
    bad 2 "--out street: .*log" render run --out street --force
    bad 2 "--out /: .*root" render run --out / --force
    mkdir home theirs && printf 'mine' >theirs/rosbag.mcap
    HOME=$work/home bad 2 "out home: .*home folder" render run --out home
    bad 2 "--out theirs: .*rosbag.mcap.*scans.json" render run --out theirs --force
    check "--force changed a file that no scans.json lists" grep -qx mine theirs/rosbag.mcap
    bad 2 "recorded: .*\(3 " render run --out recorded --format mcap
    echo '{"K": [40, 0, 31.5, 0, 40, 15.5, 0, 0, 1], "size": [64, 32]}' >camera.json
    good render run --out pictures --frames 2:4 --camera camera.json
    check "render wrote other than a picture and a depth per frame" test "$(ls pictures | wc -l)" = 5
    check "scans.json has no camera" grep -q "\"K\"" pictures/scans.json
    good render run --out pictures --frames 2:3 --camera camera.json --format npz,png --only background --force
    check "render kept pictures of an earlier rendering" test "$(ls pictures | wc -l)" = 4
    for option in "--sensor VLP-16" "--sample 1" "--weather fog=50" "--merge" "--vehicle log"; do
        # shellcheck disable=SC2086
        bad 2 "camera.*${option%% *}" render run --out x --camera camera.json $option
    done
    bad 2 "--camera camera.json: .*--format pcap" render run --out x --camera camera.json --format pcap
    bad 2 "'kity'.*'kitti'" render run --out x --camera kity
    echo '{"K": [40, 0, 31.5, 0, 40, 15.5, 0, 0, 1], "size": [64]}' >camera.json
    bad 3 "camera.json: size: found 1" render run --out x --camera camera.json
    good render run --out drawn --frames 2:4 --sample 7
    bad 2 "--sample: .*2\^64" render run --out x --frames 2:4 --sample 18446744073709551616
    good render run --out drawn_again --frames 3:4 --sample 7
    good render run --out drawn_otherwise --frames 3:4 --sample 8
    check "two scans drawn with one seed differ" cmp -s drawn/frame_000003.npz drawn_again/frame_000003.npz
    check "scans drawn with two seeds are the same" test "$(cmp -s drawn/frame_000003.npz drawn_otherwise/frame_000003.npz; echo $?)" = 1
    check "scans.json does not say how scans were drawn" grep -q '"sample": 7' drawn/scans.json
    good render run --out foggy --frames 2:4 --sample 7 --weather fog=40 --format npz,ply
    check "weather is not noted" grep -q "^relidar: note: weather fog=40: .*905 nm" err
    check "scans.json does not say the weather" grep -q '"weather": "fog=40"' foggy/scans.json
    check "points do not say why they are there" grep -qa "property int source" foggy/frame_000003.ply
    bad 2 "weather: .*fog=0" render run --out x --weather fog=0
    check "the log's own place is called unseen" test -z "$(grep -o 'not observed' err)"
    good render run --out left --frames 2:4 --offset -1,2.5,1,90
    exists left/frame_000002.npz
    exists left/frame_000003.npz
    good render run --out below --frames 2:4 --offset 0,0,-5
    check "a sensor under the ground is not warned of" \
        grep -q "^relidar: note: below: .*2 of 2 .*20 % .*scan [23] .* 9" err
    check "scans.json does not say how much is unseen" grep -q '"unseen":0.9' <(tr -d ' \n' <below/scans.json)
    good render run --out far_off --frames 2:3 --offset 9000,0,0 --channels seen
    check "the summary does not say how much is unseen" grep -q "0.0 % .* 100.0 % " out
    good render run --out other --frames 11: --sensor VLP-16
    good render run --out grid --frames all --sensor kitti360 --quiet
    check "--frames all wrote other than 12 files and scans.json" test "$(ls grid | wc -l)" = 13
    printf 'elevation_deg,max_range_m\n5,15\n0,15\n-5,15\n' >beams.csv
    good render run --out table --frames 0:1 --sensor beams.csv:64x10 --format "npz, ply"
    check "scans.json lacks the sensor's limit" grep -q '"max_range_m": 15' table/scans.json
    exists table/frame_000000.ply
    range_limits
    good render run --out beyond --frames 11:14
    check "frames beyond the log are left out without a word" grep -q "note: frames 11:14: .*frame 11" err
    good train street --out kept --preset quick --set train.iterations=1 --set dataset.test_every=0 --no-eval --quiet
    good render kept --out kept_scans
    check "render of a run that held nothing out does not say so" grep -q "note: kept .*12" err
    bad 2 "100:200" render run --out x --frames 100:200
    bad 2 '--format: "npy" .*npz' render run --out x --format npy
    bad 2 "--offset: .* 2 " render run --out x --offset 1,2
    bad 2 "--offset: .* 1e[+]?30 .* -10000 .* 10000" render run --out x --offset 1e30,0,0,0
    bad 2 "--offset: .*yaw .*1000000000" render run --out x --offset 0,0,0,1e9
    bad 2 'lidar: .*"rear"' render run --out x --lidar rear
    bad 2 '--frame: .*"wold"; .*world' render run --out x --frame wold
    bad 2 "known: native, kitti360, HDL-64E" render run --out x --sensor nativ
    good list sensors
    says "^rosette +10000 "
    good list sensors OS1-64:512x20 --out pattern.png
    says "^rays +32768 \\(64 .*512\\)"
    check "sensors --out writes no png" test "$(head -c 4 pattern.png | tail -c 3)" = PNG
    bad 2 "'VLP-16'" list sensors VLP16
    bad 2 "--out .*sensor" list sensors --out x.png
    printf '%s' '{"sensors": [{"name": "top", "sensor": "VLP-16"}, {"name": "left", "sensor": "rosette", "translation_m": [0, 1, 0],' \
        ' "yaw_pitch_roll_deg": [90, 0, 0]}]}' >rig.json
    good render run --out rig --frames 5:6 --sensor rig.json --format pcd,npz
    check "a rig has a folder for each sensor" test -s rig/top/scans.json -a -s rig/left/frame_000005.pcd
    sed 's/"rosette"/"OS1-64"/' rig.json >packet_rig.json
    good render run --out packets --frames 5:6 --sensor packet_rig.json --format pcap
    check "a rig has a capture for each sensor" test -s packets/packets_top.pcap -a -s packets/packets_left.json
    good convert packets/packets_left.pcap --out packet_log --set dataset.poses=none
    says "1 scans of 1 LiDAR"
    good convert packets/packets_top.pcap --out again.pcap --set dataset.poses=none
    says "77 packets .* 1 "
    bad 2 "packets .*VLP-16, VLP-32C" render run --out x --format pcap
    good render run --out merged --frames 5:6 --sensor rig.json --format pcd --merge
    check "a merged rig has not the points of its sensors" test "$(points_of merged/frame_000005.pcd)" -eq \
        "$(($(points_of rig/top/frame_000005.pcd) + $(points_of rig/left/frame_000005.pcd)))"
    bad 2 "--merge .*rig" render run --out x --sensor VLP-16 --merge
    layouts --frames 5:7 --sensor packet_rig.json
    bad 2 "--topic .*mcap" render run --out x --topic /points
    bad 2 '--frame-id: .*"a" .*\{name\}' render run --out x --sensor rig.json --format mcap --frame-id a
    bad 2 'topic "points", .*/lidar/points' render run --out x --frames 2:3 --format rosbag --topic points
    absent x
    bad 2 "rig/top: .*contains" render run --out rig --frames 5:6 --sensor rig.json
    echo mine >rig/left/frame_000031.npz
    bad 2 "rig/left: .*frame_000031.npz" render run --out rig --frames 5:6 --sensor rig.json --format npz --force
    exists rig/top/frame_000005.npz
    good render run --out wide --frames 5:6 --sensor VLP-16 --format npz,pcd --set sensor.sub_rays=5 --set sensor.returns=2
    check "a second return is missing from the pcd" grep -aq "^FIELDS x y z intensity ring time instance return$" wide/frame_000005.pcd
    bad 2 "sensor.sub_rays: .*XT32" render run --out x --sensor XT32 --set sensor.sub_rays=5
    bad 2 "sensor.returns.*2.*sensor.sub_rays" render run --out x --sensor VLP-16 --set sensor.returns=2
    bad 3 "folder" render run --out broken.toml/x
    absent x
}

# Prints the largest range of the points in a KITTI .bin file, in metres.
farthest() { od -An -v -t f4 -w16 "$1" | awk '{ r = $1 * $1 + $2 * $2 + $3 * $3; if (r > most) most = r } END { print sqrt(most) }'; }

# For the rendered sensor, and for the log that is read.
range_limits() {
    good render run --out far --frames 5:6 --format bin
    check "the street has nothing beyond 20 m" awk "BEGIN { exit !($(farthest far/frame_000005.bin) > 20) }"
    good render run --out near --frames 5:6 --format bin --set dataset.max_range_m=20 --sensor Native
    check "points beyond dataset.max_range_m" awk "BEGIN { exit !($(farthest near/frame_000005.bin) <= 20.5) }"
    good render run --out nothing --frames 5:6 --format ply,pcd,bin --set dataset.max_range_m=0.5
    for line in "FIELDS x y z intensity ring time instance" "POINTS 0"; do check "an empty pcd lacks: $line" grep -aqx "$line" nothing/frame_000005.pcd; done
    check "an empty ply lacks its fields" test "$(grep -ac '^property' nothing/frame_000005.ply)" = 7
    good eval run --out limited.json --set dataset.max_range_m=20
    check "eval with another range limit gives the same numbers" test "$(grep -c depth_medae limited.json)" -gt 0 -a "$(grep -m1 strict/depth_rmse_m limited.json)" != "$(grep -m1 strict/depth_rmse_m run/metrics.json)"
    bad 2 "30 to 20 m, .*dataset.min_range_m < dataset.max_range_m" info street --set dataset.max_range_m=20 --set dataset.min_range_m=30
}

points_of() { grep -am1 "^POINTS" "$1" | cut -d" " -f2; }
# Prints the largest difference between the numbers of two .bin scans.
difference() { paste <(od -An -v -t f4 -w4 "$1") <(od -An -v -t f4 -w4 "$2") | awk 'NF != 2 { most = 1e9 } { d = $1 - $2; if (d < 0) d = -d; if (d > most) most = d } END { print most + 0 }'; }

ray_drop() {
    good info run
    says "^ray drop .* [0-9]+ .*native$"
    good render run --out refined --frames 5:6
    good render run --out unrefined --frames 5:6 --no-refine
    check "--no-refine changes nothing" test "$(cmp -s refined/frame_000005.npz unrefined/frame_000005.npz; echo $?)" = 1
    cp -r run cells
    good refine cells --set sensor.grid=kitti360 --set refine.image=grid --set refine.network=small --set refine.epochs=1 --set refine.frames=3
    says "^strict/drop_accuracy"
    says '"baseline" .*network'
    check "progress of the network lacks rate and remaining time" grep -Eq "epoch 1/1  step 3/3  [0-9.]+ steps/s .* 0:00 " err
    good info cells
    says "kitti360$"
    says "kitti360: 66 rows x 1030"
    good render cells --out of_cells --frames 5:6 --sensor VLP-16
    check "render does not say that a network does not fit" \
        grep -q "^relidar: note: .*kitti360 .*8 x 8 .*VLP-16" err
    good train street --out surfels --config run/config.toml --set refine.enabled=false --no-eval --quiet
    absent surfels/drop_network.safetensors
    good refine surfels --no-eval --quiet
    check "--quiet prints" test ! -s out -a ! -s err
    bad 3 "image 0: .*8 x 96 .*16 x 16" \
        refine surfels --quiet --set refine.network=paper
    bad 2 'refine.network: .*"large", .*small, paper, pixel' refine surfels --set refine.network=large
    bad 3 "nowhere: " refine nowhere
    printf 'short' >surfels/drop_network.safetensors
    bad 3 "surfels/drop_network.safetensors" render surfels --out x
    good train street --out surfels --config run/config.toml --set refine.network=paper --no-eval --force
    check "training does not say that its network was not trained" grep -q "^relidar: warning: .*network .*image 0" err
    absent surfels/drop_network.safetensors
    absent x
}

# The exported path of the log's sensor must give the scans of the log.
own_paths() {
    good export run --out way.csv
    says "12 poses"
    good render run --out log --frames 5:6 --format bin
    good render run --out along --trajectory way.csv --times 0.5:0.5:1 --format bin
    check "the log's own path: other points than the log's own frame" awk "BEGIN { exit !($(difference log/frame_000005.bin along/frame_000000.bin) < 1e-3) }"
    check "scans.json does not name the trajectory" grep -q '"trajectory": ".*way.csv"' along/scans.json
    good render run --out twice_as_often --trajectory way.csv --rate 20 --format bin --offset 0,1,0 --quiet
    check "the log's own path is said to be outside of the log" test ! -s err
    check "11 turns at 20 Hz are not 23 scans" test "$(find twice_as_often -name '*.bin' | grep -c .)" = 23
    { cat way.csv; echo "60,400,0,2,0,0,0"; } >beyond.csv
    good render run --out after_the_log --trajectory beyond.csv --times 50:60:10 --format bin
    check "nobody says that the log has no actors then" grep -q "2 of 2 .* actors" err
    check "nobody says how far from the log that is" grep -q "trajectory .* [0-9]* m " err
    bad 3 "none.csv" render run --out x --trajectory none.csv
    bad 2 "--rate .*--times .*--trajectory" render run --out x --rate 20
    bad 2 "--frames .*--trajectory" render run --out x --trajectory way.csv --frames 1:2
    bad 2 "--rate .*--times" render run --out x --trajectory way.csv --rate 5 --times 0:1:0.1
    bad 2 "--rate: .*0" render run --out x --trajectory way.csv --rate 0
    bad 2 "1e\+06" render run --out x --trajectory way.csv --rate 1e9
    bad 2 "--times: .*\"0:1\".* FIRST:LAST:STEP" render run --out x --trajectory way.csv --times 0:1
    bad 2 "--times: .*0 .*50 s" render run --out x --trajectory way.csv --times 0:50:1
    bad 2 "FIRST < LAST .*STEP .*0" render run --out x --trajectory way.csv --times 1:0:0.1
    bad 2 "\.ply .*\.csv" export run --out way.txt
    absent x
}

# Prints x, y, z and yaw at the start of a track, in the format of the option --copy.
start_of() { "$relidar" info "$1" | awk -v track="$2" '$1 == track { for (i = 1; i <= NF; i++) if ($i ~ /^[-0-9.]+,[-0-9.]+,[-0-9.]+,[-0-9.]+$/) print $i }'; }

editing() {
    good info run
    says "^ +0 +Car .* 0-11 .* m/s .* 1 +[0-9]+$"
    says "^instances +3, .*0 .*background"
    good edit run --out removed --remove 0
    says "^removed 0$"
    good info removed
    says "edit +--remove 0 .*/run"
    check "a removed actor keeps its surfels" test "$(stat -c %s removed/model.safetensors)" -lt "$(stat -c %s run/model.safetensors)"
    local start
    start=$(start_of run 0)
    good edit run --out standing --copy "0@${start%%,*},2,ground" --copy 1@5,0,ground,90:3 --insert run#0@9,0,ground
    says "copied 0 as 0-copy-1, .*,2.00,0.8[0-9], .*[01][.]. degrees"
    says "inserted 0 .*0-insert-1, .*ground"
    good info standing
    says "edit +--copy 1@5,0,ground,90:3"
    good edit run --out tilted --copy "0@$start,4,-3:2"
    good edit run --out edited --move 0:0,3.5,0 --copy "0@$start:8" --move 0-copy-1:0,-3,0,10 --copy "0-copy-1@$start" --retime 1=0.3 --remove 0
    says "0 as 0-copy-1"
    good info edited --json
    check "edits are not told in the order given" test "$(grep -c '"edit": "--' out)" = 6
    check "the first edit is not the first told" test "$(grep '"edit": "--' out | head -1)" = '      "edit": "--move 0:0,3.5,0"'
    check "a model placed twice is held twice" grep -q '"instances": 4' out
    mv edited moved && mv run away   # an edited run must not depend on the original run
    good render moved --out moved_scans --frames 5:6 --format npz,ply
    mv away run
    check "ply lacks instances" grep -aq "^property int instance" moved_scans/frame_000005.ply
    good edit moved --out again2 --keep background
    good render again2 --out background --frames 5:6
    good edit run --out both --insert "removed#1@$start:3"
    says "inserted 1 .*1-insert-1"
    printf 'time_s,x,y,z,yaw_deg\n0.2,1,2,3,0\n0.9,4,2,3,0\n' >way.csv
    good edit run --out path --trajectory 1:way.csv
    good info path
    says "^ +1 +Car .* 2-9 "
    "$tests/../../tools/examples/openscenario.py" "$tests/cut_in.xosc" run paths Van=1 Car=0 >options
    check "openscenario.py prints $(<options)" test "$(xargs <options)" = "--trajectory 1:paths/Van.csv --trajectory 0:paths/Car.csv"
    # the box of the car has 1.4 m in the file, and another height in the run
    check "Van is not where its box is" grep -Eq '^0\.25,11\.5,-3\.5,1\.[0-9]+,0\.0,0\.0,0\.0$' paths/Van.csv
    check "Car does not end at 7.5 s" grep -Eq '^7\.5,9\.2,1\.1,' paths/Car.csv
    good edit run --out cut_in --trajectory 1:paths/Van.csv
    good info cut_in
    says "^ *1 +Car .* [23]-11 .* 11\.50,-3\.50,"
    sed 's/ z="[0-9.]*"\( h\)/\1/' "$tests/cut_in.xosc" >level.xosc   # positions without z are on the ground
    "$tests/../../tools/examples/openscenario.py" level.xosc run paths Van=1 Car=0 >/dev/null
    check "Van is not on the ground" grep -Eq '^0\.25,11\.5,-3\.5,ground,' paths/Van.csv
    good export run --out van.csv --track 1
    good edit run --out unchanged --trajectory 1:van.csv
    check "the exported path is no path" grep -Eq "^time_s,x,y,z,yaw_deg,pitch_deg,roll_deg$" van.csv
    bad 2 '--track 9: .*tracks: 0, 1' export run --out van.csv --track 9
    bad 2 '--out van.ply: .*\.csv' export run --out van.ply --track 1
    bad 2 '--speed 0=0: .*above 0' edit run --out x --speed 0=0
    good edit run --out late --retime 0=100
    says "note: actor 0 .*visible"
    sed 's/"name": "synthetic"/"name": "other"/' -i removed/scene.json
    good edit run --out both --force --insert "removed#1@$start"
    says "note: removed .*sensor"
    good eval moved --out edited.json
    says "note: .*edited"
    good render run --out cars --frames 5:6 --only actors
    check "a scan without background has an unobserved share" test -z "$(cat out err | grep "has not observed")"
    good render run --out car --frames 5:6 --only 0 --only background --format ply
}

# Uses two cars of the street. The log has observed different sides of them.
keeping_assets() {
    good assets run --out assets --least 0.05
    says "^asset +class +score +front +rear +left +right +top +mirrored"
    says "^car-0 +Car +0\.[0-9]+ "
    says "^saved 2 of 2 .*assets$"
    for name in car-0 car-1; do exists "assets/$name/asset.json"; exists "assets/$name/views.png"; done
    good info assets/car-0
    says "^boxes +1: "
    good edit run --out furnished --insert "assets/car-0@$(start_of run 1)" --insert "assets/car-0@$(start_of run 0):8"
    says "car-0 .*assets/car-0 .*car-0$"
    says "car-0 .*assets/car-0 .*car-0-insert-1$"
    good render assets/car-0 --out asset_scans --frames 5:6 --format ply
    local most
    most=$("$relidar" assets run --out every --least 0 2>/dev/null | awk '/^car-/ && $3 > most { most = $3 } END { print most }')
    bad 3 "2 actors .*[01] \(Car\): .*0\.[0-9]+.*1.00 .*--least" assets run --out none --least 1 --quiet
    absent none
    check "a score above 1: $most" awk "BEGIN { exit !($most <= 1) }"
    bad 2 "assets: .*empty" assets run --out assets
    bad 2 "--least: .*2" assets run --out none --least 2
    bad 2 "actor" assets again2 --out none
    bad 3 "nowhere: " assets nowhere --out none
    absent none
    check "unfinished folders were left behind" test -z "$(find . -maxdepth 1 -name '.*tmp*')"
}

wrong_edits() {
    bad 2 "edit" edit run --out x
    bad 2 'track, .*"0"' edit run --out x --remove 00
    bad 2 '--move 7:1,0,0: .*track "7"' edit run --out x --move 7:1,0,0
    bad 2 '--move: .*"0:1,2", .*TRACK:dx,dy,dz' edit run --out x --move 0:1,2
    bad 2 '--move: .*"nan"' edit run --out x --move 0:1,nan,2
    bad 2 '--move: .*"0", .*TRACK' edit run --out x --move 0
    bad 2 '--retime: .*"0:1", expected TRACK=SECONDS' edit run --out x --retime 0:1
    bad 2 '--copy: .*"0@1,2,3", .*TRACK@x,y,z,yaw_deg' edit run --out x --copy 0@1,2,3
    bad 2 '--copy: .*"0@1,ground", .*TRACK@x,y,z,yaw_deg.*TRACK@x,y,ground' edit run --out x --copy 0@1,ground
    bad 2 '--copy 0@900,2,ground: .*900,2 ' edit run --out x --copy 0@900,2,ground
    bad 2 'insert run#7@1,2,ground: .*track "7"' edit run --out x --insert run#7@1,2,ground
    bad 2 '--copy: .*"@1,2,3,4"' edit run --out x --copy @1,2,3,4
    bad 2 '--copy: .*"" .*""' edit run --out x --copy 0@1,2,3,4:
    bad 2 'insert run@1,2,3,4: .*2 actors, .*RUN#TRACK .*0, 1' edit run --out x --insert run@1,2,3,4
    bad 3 'nowhere: ' edit run --out x --insert nowhere@1,2,3,4
    bad 2 '--insert: .*"run#@1,2,3,4", .*RUN#TRACK' edit run --out x --insert run#@1,2,3,4
    bad 3 'nowhere: ' edit run --out x --insert nowhere#0@1,2,3,4
    bad 2 '--keep: .*"car"' edit run --out x --keep car
    bad 3 'none.csv' edit run --out x --trajectory 0:none.csv
    bad 2 'run .*edit' edit run --out ./run --remove 0
    bad 2 'removed: .*contains' edit run --out removed --remove 0
    bad 3 'nowhere: ' edit nowhere --out x --remove 0
    bad 2 '"cars" .*background' render run --out x --only cars
    absent x
}

evaluation() {
    cp run/metrics.json before.json
    good eval run
    says "strict/depth_medae_m"
    says "^points/cd_mean_m"
    says "^actors/tail_share_real "
    check "eval gives other numbers than train" diff <(sed -n '/"mean"/,/}/p' before.json) <(sed -n '/"mean"/,/}/p' run/metrics.json)
    good eval run --out sub/metrics.json --set render.range=normalised
    exists sub/metrics.json
    bad 3 "folder" eval run --out broken.toml/m.json
    bad 3 "nowhere: " eval run --set dataset.path=nowhere
    mkdir short && sed 's/^n_frames.*/n_frames = 8/' street/street.toml >short/street.toml
    bad 3 "frame 10" eval run --set dataset.path=short
}

# Eight rows of 48 rays are not enough to register a scan.
lost_scans() {
    mkdir sparse && sed 's/^columns.*/columns = 48/' street/street.toml >sparse/street.toml
    good train sparse --out unmoved --preset quick --set train.iterations=1 --no-eval
    check "lost scans: no note" grep -Eq "12 of 12 .*keep the poses of the log" out
    check "lost scans: moved" grep -q "corrected by a median of 0.000 m" out
    # The warning about the motion is the first of two lines.
    "$relidar" train sparse --out adrift --quiet --preset quick --set train.iterations=1 --set dataset.poses=none >out 2>err
    local found=$?
    check "lost scans: exit code $found, expected 3" test "$found" = 3
    check "lost scans: no error" grep -Eq "[0-9]+ of 12 .*5 %.*train.allow_lost_scans" err
    good train sparse --out adrift --quiet --preset quick --set train.iterations=1 --set dataset.poses=none --set train.allow_lost_scans=true --no-eval
    bad 2 "dataset.poses=none.*train.refine_poses=sensor" train street --out adrift --force --set dataset.poses=none --set train.refine_poses=none
    rm -r adrift unmoved sparse
}

# The weights must be read before files are created. --no-eval needs no weights.
wrong_weights() {
    RELIDAR_LPIPS_WEIGHTS=missing.safetensors bad 3 "missing.safetensors" train street --out unweighted
    absent unweighted
    RELIDAR_LPIPS_WEIGHTS=missing.safetensors bad 3 "missing.safetensors" demo --out unweighted
    absent unweighted
    RELIDAR_LPIPS_WEIGHTS=missing.safetensors good train street --out unweighted --quiet --preset quick --set train.refine_poses=none --set train.iterations=1 --no-eval
    rm -r unweighted
}

# The baseline needs no device.
baseline() {
    good eval street --baseline nearest --set dataset.test_every=5 --out base/metrics.json --pictures base/pictures
    says "^strict/depth_medae_m +[0-9.]+ +[0-9.]+ +[0-9.]+$"
    says "^moving_boxes +[1-9]"
    says "^peer/depth_lpips +no "
    says "drop_prob < 0.4$"
    for key in '"scored": "baseline nearest"' '"lpips": "no weights"' '"strict/cd_mean_m"' '"moving_boxes/depth_medae_m"'; do check "metrics.json lacks $key" grep -q "$key" base/metrics.json; done
    for picture in range intensity drop; do exists base/pictures/${picture}_000010.png; done
    good eval street --baseline nearest --set dataset.test_frames=3,7:9 --quiet --pictures named
    for frame in 3 7 8; do exists named/range_00000$frame.png; done
    absent named/range_000010.png
    bad 2 "dataset.test_frames: .*frame 99" eval street --baseline nearest --set dataset.test_frames=3,99
    for set in train.iterations=3 sensor.grid_method=cast dataset.path=elsewhere; do
        bad 2 "${set%=*} .*eval LOG --baseline" eval street --baseline nearest --set $set
    done
    # a log without intensities, whose points only have x, y and z
    mkdir -p dark/scans
    for scan in 0 1 2; do awk 'BEGIN { print "ply\nformat ascii 1.0\nelement vertex 72\nproperty float x\nproperty float y\nproperty float z\nproperty ushort ring\nend_header"
        for (ring = 0; ring < 2; ++ring) for (k = 0; k < 36; ++k) print 20 * cos(k * 0.1745329), 20 * sin(k * 0.1745329), 1 - 2 * ring, ring }' >dark/scans/$scan.ply; done
    printf '{"format": "relidar log", "version": 1, "rate_hz": 10}' >dark/sequence.json
    printf '1 0 0 0 0 1 0 0 0 0 1 0\n%.0s' 1 2 3 >dark/poses.txt
    good eval dark --baseline nearest --set dataset.test_frames=1 --pictures dark_pictures
    for picture in range drop; do exists dark_pictures/${picture}_000001.png; done
    absent dark_pictures/intensity_000001.png
    good eval street --baseline nearest-actors --set dataset.test_every=5 --quiet
    check "eval --quiet prints" test ! -s out -a ! -s err
    printf 'no weights' >weights.safetensors
    RELIDAR_LPIPS_WEIGHTS=weights.safetensors bad 3 "weights.safetensors" eval street --baseline nearest --set dataset.test_every=5
    RELIDAR_LPIPS_WEIGHTS=missing.safetensors bad 3 "missing.safetensors" eval street --baseline nearest --set dataset.test_every=5
}

baseline_beside_a_run() {
    good eval run --baseline nearest --out beside.json
    says "^metric +mean +lowest +highest +baseline nearest"
    check "beside.json lacks the baseline" grep -q '"scored": "baseline nearest"' beside.json
    bad 2 "--frames .*run" eval run --baseline nearest --frames 0:5
}

surfels_as_ply() {
    good export run --out ply/scene.ply
    says "scene.ply: [0-9]+ surfels"
    good edit run --from-ply ply/scene.ply --out imported
    check "the imported model differs" cmp run/model.safetensors imported/model.safetensors
    good info imported
    bad 2 "imported: .*--force" edit run --from-ply ply/scene.ply --out imported
    # Editors do not keep the properties that they do not know.
    LC_ALL=C sed -E 's/^(property float) (hit_|drop_|model|gait_)/\1 unknown_\2/' ply/scene.ply >ply/usual.ply
    good edit run --from-ply ply/usual.ply --out usual
    says "^note: ply/usual.ply: .* hit_0"
    check "the restored model differs" cmp run/model.safetensors usual/model.safetensors
    bad 3 "broken.toml.*begin" edit run --from-ply broken.toml --out x
    absent x
}

gaussians() {
    local few=(--preset quick --set train.refine_poses=none --set init.actor_min_points=10 --set train.iterations=4 --set dataset.test_every=5)
    good train street --out thick "${few[@]}" --set image.primitive=gaussian --set densify.strategy=adaptive
    good info thick
    says "^surfels +[0-9]+ 3D Gaussians$"
    good render thick --out thick_scans --frames 5:6
    exists thick_scans/frame_000005.npz
    good export thick --out ply/thick.ply
    good edit thick --from-ply ply/thick.ply --out thick_again
    check "the imported model of 3D Gaussians differs" cmp thick/model.safetensors thick_again/model.safetensors
    good edit thick --out thick_actors --keep actors
    good check --speed --run thick
    bad 2 "image.primitive=surfel, .*gaussian" render thick --out x --frames 5:6 --set image.primitive=surfel
    bad 3 "3D Gaussians .*surfels" edit thick --out x --insert "run#0@$(start_of run 0)"
    cp run/model.safetensors thick_again/
    sed 's/"surfels": [0-9]*/"surfels": '"$("$relidar" info run | sed -n 's/^surfels *//p')/" -i thick_again/scene.json
    bad 3 "thick_again/config.toml: image.primitive .*gaussian, .*model.safetensors .*surfels" info thick_again
    absent x
}

# tests/view tests the server and the page.
viewing() {
    good view --help
    if ! grep -q -- "--port" out; then
        bad 2 "libboost-dev" view run
        return
    fi
    says "Example"
    bad 3 "nowhere: " view nowhere
    bad 2 "--port: .*65536.*65535" view run --port 65536
    bad 2 'address "example.com"' view run --bind example.com
    bad 3 "folder .*run/config.toml" view run --save-to run/config.toml
    "$relidar" view run --port 0 --bind 0.0.0.0 --quiet >address 2>err &
    local pid=$! port
    for _ in $(seq 300); do
        [[ ! -s address ]] || break
        sleep 0.1
    done
    check "the address of a viewer for others has no token" grep -Eq '^http://127.0.0.1:[0-9]+/\?token=[0-9a-f]{32}$' address
    port=$(sed 's/.*:\([0-9]*\).*/\1/' address)
    bad 2 "port $port of 0.0.0.0: Address already in use" view run --bind 0.0.0.0 --port "$port"
    kill -INT $pid
    ends 0 "a viewer that Ctrl-C has ended"
}

# Ctrl-C during the initialisation: only the settings and an empty log must stay.
early_interruption() {
    "$relidar" train street --out early --preset quick --set train.refine_poses=none --set train.iterations=2 --set refine.enabled=false >out 2>err &
    local pid=$!
    until [[ -e early/log.jsonl ]] || ! kill -0 $pid 2>/dev/null; do sleep 0.01; done
    kill -TERM $pid
    ends 130 "interrupted initialisation"
    check "interrupted initialisation does not say how to start again" grep -Eq "^relidar: .*--resume early$" err
    check "interrupted initialisation left other files" test "$(ls -A early | tr '\n' ' ')" = "config.toml log.jsonl "
    good train --resume early --no-eval
    check "the run that started again lacks an iteration" test "$(grep -c '"iteration":2,' early/log.jsonl)" = 1
    exists early/scene.json
}

interruption() {
    "$relidar" train street --out stopped --preset quick --set train.refine_poses=none --set train.iterations=1000000 --set train.log_every=1 >out 2>err &
    local pid=$!
    for _ in $(seq 600); do
        [[ ! -s stopped/log.jsonl ]] || break
        sleep 0.1
    done
    mv err first_err
    bad 3 "stopped: .*process" train street --out stopped
    bad 3 "stopped: .*process" train street --out stopped --force
    bad 3 "stopped: .*process" train --resume stopped
    bad 3 "stopped: .*process" edit run --out stopped --remove 0 --force
    good info stopped
    says "^stopped: .* [0-9]* of 1000000; .*street$"
    mv first_err err
    kill -TERM $pid
    ends 130 "interrupted training"
    check "interrupted training does not say how to go on" grep -Eq "^relidar: .* [0-9]+ of 1000000; .*--resume stopped$" err
    stopped_at=$(sed -n 's/.*interrupted after iteration \([0-9]*\) .*/\1/p' err)
    good info stopped
    absent stopped/.lock
    # a process that holds the lock and is killed
    flock --no-fork stopped/.lock sleep 600 &
    pid=$!
    while flock --nonblock stopped/.lock true; do sleep 0.05; done
    bad 3 "stopped: .*process" eval stopped
    kill -KILL $pid
    wait $pid 2>/dev/null
    good eval stopped --quiet
    absent stopped/.lock
}

# From the newest checkpoint that can be read.
resuming() {
    [[ -n $stopped_at ]] || return 0   # a previous check has already reported this failure
    local total=$((stopped_at + 3))
    bad 2 "iteration $stopped_at: .*loss.depth: .*0.3, .*0.1" train --resume stopped --set loss.depth=0.3
    good train --resume stopped --set train.iterations=$total --set train.checkpoint_minutes=1e-9 --no-eval
    says "^resume .* $stopped_at$"
    check "the resumed log does not have each iteration once" diff <(seq 1 $total) <(grep -o '"iteration":[0-9]*' stopped/log.jsonl | cut -d: -f2)
    check "config.toml lacks the raised iterations" grep -qx "iterations = $total" stopped/config.toml
    check "other than two checkpoints are kept" test "$(ls stopped/checkpoints | wc -l)" = 2
    good train --resume stopped
    says "$total iterations"
    head -c 2000 stopped/checkpoints/*$total.safetensors >cut.bin && mv cut.bin stopped/checkpoints/*$total.safetensors
    # tests the flag in front of the log
    good train --resume street --out stopped --set train.iterations=$((total + 2)) --no-eval
    says "^resume .* $((total - 1))$"
    check "the damaged checkpoint is not named" grep -Eq "^relidar: warning: .*safetensors .*$total.safetensors" err
    exists stopped/checkpoints/iteration_*$((total + 2)).safetensors
    # simulates a process that was killed while it wrote its first file
    mkdir anew && touch anew/.lock anew/.config.toml.tmp-1-0
    good train street --out anew --preset quick --set train.refine_poses=none --set train.iterations=2 --no-eval --resume
    absent anew/.config.toml.tmp-1-0
    check "a run without checkpoint starts anew without a word" grep -q "^relidar: warning: anew " err
    bad 2 "checkpoint" train --resume anew --set train.iterations=4
    bad 3 "iteration 1.*: (.*intensity|row [0-9]+ of array .* inf)" train street --out lost --quiet --preset quick --set train.refine_poses=none --set loss.intensity=3e38 --set train.log_every=1 --set train.checkpoint_minutes=1e-9
    absent lost # A failed training must not block the corrected command.
}

# Ctrl-C during the training of the network. tools/dev/kill_test compares the networks.
network_resuming() {
    local few=(--preset quick --set train.refine_poses=none --set init.actor_min_points=10 --set train.iterations=4 --set dataset.test_every=5 --set refine.network=small)
    local checkpoints=half/checkpoints/drop_network
    stop_in_network train street --out half "${few[@]}" --set refine.epochs=15 --no-eval
    check "interrupted network: the message does not say how to go on" grep -Eq "^relidar: .*ray-drop .*--resume half$" err
    absent half/drop_network.safetensors
    rm -rf other && cp -r half other
    good train --resume half --no-eval
    says "^resume  .*ray-drop .*step [1-9]"
    exists half/report.html
    absent half/checkpoints
    good train --resume half
    says "finished"
    good train --resume other --no-eval --set refine.epochs=1
    check "other settings of the network are taken without a word" grep -Eq "^relidar: warning: .*step [0-9]+: .*refine.epochs: .*1, .*15 " err
    exists other/drop_network.safetensors
    stop_in_network refine other --no-eval --set refine.epochs=15
    check "interrupted refine: the message does not say how to go on" grep -Eq "^relidar: .*refine --resume other$" err
    bad 2 "step [0-9]+: .*refine.rate: .*0.5" refine --resume other --set refine.rate=0.5
    good refine --resume other --no-eval
    says "^resume .*step [1-9]"
    absent other/checkpoints
    good refine --resume other --no-eval --set refine.epochs=1
    check "nobody says that there is nothing to resume" grep -q "^relidar: warning: other " err
}

# stop_in_network ARGS...: ends a training by SIGTERM after a file in $checkpoints exists.
stop_in_network() {
    [[ $1 == train ]] || checkpoints=$2/checkpoints/drop_network
    "$relidar" "$@" >out 2>err &
    local pid=$!
    for _ in $(seq 1200); do
        ! compgen -G "$checkpoints/iteration_*.safetensors" >/dev/null || break
        sleep 0.05
    done
    kill -TERM $pid
    ends 130 "interrupted $1"
    check "interrupted $1 leaves no checkpoint of its network" compgen -G "$checkpoints/iteration_*.safetensors" >/dev/null
}

# With the same faults, the first use of the device must select different methods.
checking() {
    local faults wrong="compare-and-swap sums"
    "$relidar" list devices --json >devices.json
    faults=float_swaps,ray_query
    if grep -q '"ray_query": true' devices.json; then wrong+=", tree of ray query"; fi
    # Uses a memory limit, because writing 2 GiB takes a long time.
    RELIDAR_MEMORY_LIMIT_MIB=512 RELIDAR_FAULTS=$faults bad 4 "checks gave wrong results .*: $wrong\$" check --run run --json check.json
    for row in "run, software +right" "subgroups +right" "sort +right" "tree of software +right" "gradients, software +right" "Adam +right" "points on the device +right"; do
        says "^$row"
    done
    check "check.json lacks its wrong result" grep -q '"result": "wrong"' check.json
    check "check.json lacks its device" grep -q '^ "driver": "' check.json
    grep -q '"ray_query": true' devices.json || return
    RELIDAR_FAULTS=ray_query good render run --out replaced --frames 10:11 --traversal ray_query
    check "no line on the replaced ray queries" grep -q "software" err
}

bench() {
    good check --speed --json numbers/bench.json
    says "^traversal +(software|ray_query)$"
    says "^scene +benchmark street, 100000 surfels, 65536 rays \(64 x 1024\)$"
    for row in "tree +build [0-9.]+ ms, refit [0-9.]+ ms" "forward +[0-9.]+ ms, [0-9.]+ Mrays/s" "backward +[0-9.]+ ms, [0-9.]+ Mrays/s" "iteration +[0-9.]+ ms"; do
        says "^$row"
    done
    check "bench without a run reports scans" test -z "$(grep '^scans' out)"
    "$relidar" list devices --json | grep -o '"name": ".*"' | cut -d'"' -f4 >names
    check "bench reports a device that is not listed" grep -qxF "$(sed -n 's/^ "device": "\(.*\)",$/\1/p' numbers/bench.json)" names
    for row in '"format": "relidar check --speed"' '"surfels": 100000' '"rays": 65536' '"build_ms": [0-9.]*[1-9]' '"refit_ms": [0-9.]*[1-9]' \
        '"backward_ms": [0-9.]*[1-9]'; do check "bench.json lacks $row" grep -Eq "^ $row" numbers/bench.json; done
    # A step takes longer than its forward pass. Rates are 65536 rays divided by the time.
    check "bench.json: times or rates that contradict each other" awk -F '[:,]' '{gsub(/[" ]/, "", $1); v[$1] = $2}
        END {rate = 65.536 / v["forward_ms"]; exit !(v["iteration_ms"] > v["forward_ms"] / 2 && v["forward_mrays_per_s"] / rate > 0.999 && v["forward_mrays_per_s"] / rate < 1.001)}' numbers/bench.json
    good check --speed --run run --json run.json
    says "^scans +[0-9.]+ "
    check "bench --run: other rays than the run's 8 x 96" grep -q '"rays": 768' run.json
    check "bench --run: other surfels than the run's" grep -q "\"surfels\": $("$relidar" info run | sed -n 's/^surfels *\([0-9]*\).*/\1/p')," run.json
    check "run.json lacks scans_per_s" grep -Eq '"scans_per_s": [0-9.]*[1-9]' run.json
    good check --speed --run run --sensor rig.json
    says "^ +[0-9.]+ per second"
    bad 2 "--sensor .*--speed .*--run" check --speed --sensor rig.json
    bad 2 "run: .*log" train run --out x
    bad 2 "--frames.*run" info run --frames 0:3
    bad 3 "nowhere: " check --speed --run nowhere --json lost.json
    absent lost.json
}

demo() {
    good demo --out demo --set train.iterations=2 --set init.voxel_m=0.5 --set refine.epochs=1
    for file in report.html street/street.toml run/model.safetensors run/report.html run/metrics.json; do exists demo/$file; done
    for folder in held_out shifted; do
        for format in npz png ply exr; do exists demo/$folder/frame_000010.$format; done
    done
    says "shifted sensor"
    says "report +/.*/demo/report.html"
}

mkdir street
printf 'seed = 5\nn_frames = 12\nrows = 8\ncolumns = 96\n' >street/street.toml
help_tells
wrong_usage
no_driver
log_info
converting
baseline
if "$relidar" list devices >out 2>err; then
    devices
    training
    rendering
    ray_drop
    own_paths
    on_earth
    editing
    keeping_assets
    wrong_edits
    lost_scans
    wrong_weights
    evaluation
    baseline_beside_a_run
    surfels_as_ply
    gaussians
    viewing
    bench
    checking
    demo
    # These repeat device calls of the commands above without the validation layer.
    export RELIDAR_VALIDATION=0
    early_interruption
    interruption
    resuming
    network_resuming
elif [[ ${RELIDAR_REQUIRE_GPU:-0} == 1 ]]; then
    fail "no Vulkan device, and RELIDAR_REQUIRE_GPU=1"
else
    skipped=1
fi
finish_checks
