# SPDX-License-Identifier: Apache-2.0
# relidar_precompile(<target> [<header>...] [REUSE <target>]): with
# RELIDAR_PRECOMPILED_HEADERS, parses the headers that nearly every file includes (the
# standard library, GLM, fmt and the given headers) once per target. With REUSE several
# targets share them. Intended for the many small programs of the tests; folders that are
# compiled together (relidar_unity()) gain nothing. Files must still include all headers
# that they use, because preset dev builds without precompiled headers.
function(relidar_precompile target)
    # Clang rejects headers that were compiled with other definitions than the file's. GCC
    # accepts them.
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

# relidar_optimise_little(<target>): for release builds of code that only parses, calls
# the library and writes output. Its headers (CLI11, Beast, pybind11) generate much code
# that runs once. With -O1 it compiles in two thirds of the time.
function(relidar_optimise_little target)
    target_compile_options(${target} PRIVATE $<$<AND:$<CXX_COMPILER_ID:GNU,Clang>,$<CONFIG:Release>>:-O1>)
endfunction()
