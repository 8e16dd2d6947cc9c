# SPDX-License-Identifier: Apache-2.0
# relidar_set_warnings(<target>): enables warnings for our code. They are errors if
# RELIDAR_WERROR is on (preset dev).
# -Wconversion is not used, because arithmetic of floats and counts is common here and its
# warnings are not useful.
function(relidar_set_warnings target)
    if(MSVC)
        target_compile_options(${target} PRIVATE /W4 $<$<BOOL:${RELIDAR_WERROR}>:/WX>)
        return()
    endif()
    target_compile_options(${target} PRIVATE
        -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual -Wcast-qual -Wformat=2 -Wundef
        $<$<BOOL:${RELIDAR_WERROR}>:-Werror>)
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
        # False warnings of the g++ 12 optimiser about GLM, std::vector and std::string.
        target_compile_options(${target} PRIVATE -Wno-maybe-uninitialized -Wno-array-bounds -Wno-stringop-overflow
            -Wno-stringop-overread -Wno-restrict)
    endif()
endfunction()
