# SPDX-License-Identifier: Apache-2.0
# relidar_precompile(<target> [<header>...] [REUSE <target>]): with RELIDAR_PRECOMPILED_HEADERS, what nearly every file of a target includes
# (the standard library, GLM and fmt, and the headers given) is parsed once a target, or once for several that REUSE one's. For the many
# small programs of the tests: where a whole folder is compiled together (relidar_unity()), it costs as much as it saves. Files include what
# they use all the same: preset dev builds without.
function(relidar_precompile target)
    # clang refuses headers compiled with other definitions than a file's; GCC takes them
    if(NOT RELIDAR_PRECOMPILED_HEADERS OR NOT CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
        return()
    endif()
    cmake_parse_arguments(PARSE_ARGV 1 pch "" "REUSE" "")
    if(pch_REUSE AND NOT pch_REUSE STREQUAL target)
        target_precompile_headers(${target} REUSE_FROM ${pch_REUSE})
        return()
    endif()
    target_precompile_headers(${target} PRIVATE <algorithm> <array> <chrono> <cmath> <cstdint> <filesystem> <fstream> <functional> <map>
        <memory> <numeric> <optional> <span> <string> <string_view> <vector> <glm/glm.hpp> <glm/gtc/quaternion.hpp> <fmt/format.h>
        <fmt/ranges.h> ${pch_UNPARSED_ARGUMENTS})
endfunction()

# relidar_optimise_little(<target>): for what parses, asks the library and writes down, in releases. Its headers (CLI11, Beast, pybind11)
# make much code that runs once: at -O1 it is compiled in two thirds of the time.
function(relidar_optimise_little target)
    target_compile_options(${target} PRIVATE $<$<AND:$<CXX_COMPILER_ID:GNU,Clang>,$<CONFIG:Release>>:-O1>)
endfunction()
