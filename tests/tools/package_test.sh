#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
#
# Tests the Debian package that `cpack` makes from a built tree: its files, its
# description, its program and its library.
#
#   package_test.sh BUILD_FOLDER WORK_FOLDER [CMAKE_OPTIONS of tests/consumer...]
#
# Exits 77 (skipped) if the programs that build a Debian package are missing.
set -euo pipefail
build=$(realpath "${1:?usage: package_test.sh BUILD_FOLDER WORK_FOLDER}")
work=${2:?usage: package_test.sh BUILD_FOLDER WORK_FOLDER}
shift 2
tests=$(realpath "$(dirname "${BASH_SOURCE[0]}")/..")
rm -rf "$work" && mkdir -p "$work" && cd "$work"
export LC_ALL=C

fail() { printf 'package: %s\n' "$*" >&2; exit 1; }
for program in dpkg-deb dpkg-shlibdeps file readelf; do
    command -v "$program" >/dev/null || { echo "package: no $program"; exit 77; }
done

# make_package FOLDER: makes a package and prints its path. Uses gzip, because xz takes
# longer than all other steps of this test.
make_package() {
    (umask 077 && cpack --config "$build/CPackConfig.cmake" -B "$PWD/$1" -D CPACK_DEBIAN_COMPRESSION_TYPE=gzip) >"$1.log" 2>&1 \
        || fail "cpack failed: $(cat "$1.log")"
    ls "$PWD/$1"/*.deb
}

export SOURCE_DATE_EPOCH=1700000000
deb=$(make_package first)
[[ $(basename "$deb") =~ ^relidar_[0-9.]+_[a-z0-9]+\.deb$ ]] || fail "the package is $deb, expected one relidar_<version>_<architecture>.deb"
cmp "$deb" "$(make_package second)" || fail "two packages of the same build differ"
dpkg-deb -x "$deb" root

# The package must contain exactly the files that `cmake --install` installs, owned by
# root and not writable by other users.
cmake --install "$build" --prefix "$PWD/prefix/usr" >/dev/null
diff <(cd prefix && find . | sort) <(cd root && find . | sort) || fail "the package (>) holds other files than cmake --install (<) makes"
foreign=$(dpkg-deb -c "$deb" | awk '!($1 ~ /^(drwxr-xr-x|-rwxr-xr-x|-rw-r--r--|lrwxrwxrwx)$/ && $2 == "root/root")')
[[ -z $foreign ]] || fail "wrong owner or mode: $foreign"
for path in bin/relidar lib/librelidar.a include/relidar lib/cmake/relidar/relidarConfig.cmake share/doc/relidar/copyright; do
    [[ -e root/usr/$path ]] || fail "/usr/$path is missing"
done
[[ $(ls root/usr/bin) == relidar ]] || fail "other programs than relidar are installed: $(ls root/usr/bin)"
relidar=$PWD/root/usr/bin/relidar
! readelf -S "$relidar" | grep '\.symtab' >/dev/null || fail "the program is not stripped"
# libraries that are compiled in, so the package must contain their licences
for library in volk eigen3 nanoflann nlohmann-json3 glm cli11; do
    grep -q "^=* .*$library-dev =*$" root/usr/share/doc/relidar/copyright || fail "the copyright file lacks $library"
done

# Checks the description of the package.
field() { dpkg-deb -f "$deb" "$1"; }
version=$("$relidar" --version)
[[ "relidar $(field Version)" == "$version" ]] || fail "Version is $(field Version), the program says $version"
[[ $(zcat root/usr/share/doc/relidar/changelog.gz) == "relidar ($(field Version)) "* ]] || fail "the newest entry of the changelog is not of $(field Version)"
readelf -d "$relidar" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p' >needed
[[ -s needed ]] || fail "the program needs no shared library"
sed 's|^|*/|' needed | tr '\n' '\0' | xargs -0 dpkg -S >owners
while read -r library; do
    # several packages, if libraries of more than one architecture are installed
    owners=$(sed -n "s|:.*/$library\$||p" owners | sort -u)
    field Depends | tr ',' '\n' | sed 's/(.*//; s/ //g' | grep -xF "$owners" >/dev/null || fail "Depends has none of $owners for $library: $(field Depends)"
done <needed
[[ " $(field Depends)," == *" libvulkan1,"* ]] || fail "Depends lacks libvulkan1: $(field Depends)"

# Checks the program and the library of the package.
"$relidar" list devices >devices.log || fail "devices failed: $(cat devices.log)"
cmake -DBUILD_DIR="$build" -DPREFIX="$PWD/root/usr" -DWORK_DIR="$PWD/consumer" "$@" -P "$tests/consumer/run.cmake" || fail "nothing can be built with the library of the package"
printf 'package: %s, %d bytes, %d files\n' "$(basename "$deb")" "$(stat -c %s "$deb")" "$(find root -type f | wc -l)"
