# SPDX-License-Identifier: Apache-2.0
# relidar_set_warnings(<target>): warnings of our own code; errors where RELIDAR_WERROR is on (preset dev).
# Not among them: -Wconversion (float arithmetic on counts is everywhere here and says nothing).
function(relidar_set_warnings target)
    if(MSVC)
        target_compile_options(${target} PRIVATE /W4 $<$<BOOL:${RELIDAR_WERROR}>:/WX>)
        return()
    endif()
    target_compile_options(${target} PRIVATE
        -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor -Woverloaded-virtual -Wcast-qual -Wformat=2 -Wundef
        $<$<BOOL:${RELIDAR_WERROR}>:-Werror>)
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
        # Suspicions of the optimiser, wrong ones about GLM, std::vector and std::string in g++ 12.
        target_compile_options(${target} PRIVATE -Wno-maybe-uninitialized -Wno-array-bounds -Wno-stringop-overflow
            -Wno-stringop-overread -Wno-restrict)
    endif()
endfunction()
