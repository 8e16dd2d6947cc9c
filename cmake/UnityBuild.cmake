# SPDX-License-Identifier: Apache-2.0
# relidar_unity(<target> [<folders>...]): with RELIDAR_UNITY, files are compiled together, so that headers are parsed and templates are made
# once for all of them: those of the folders that an argument names ("train train/poses", "." for the target's own), and those of any other
# folder by themselves. Names in anonymous namespaces are therefore unique among files that are compiled together. Files say what they
# include all the same: preset dev compiles each alone.
function(relidar_unity target)
    if(NOT RELIDAR_UNITY)
        return()
    endif()
    foreach(together IN LISTS ARGN)
        separate_arguments(folders UNIX_COMMAND "${together}")
        list(GET folders 0 group)
        string(MAKE_C_IDENTIFIER "in_${group}" group)
        foreach(folder IN LISTS folders)
            string(MAKE_C_IDENTIFIER "in_${folder}" folder)
            set(group_${folder} ${group})
        endforeach()
    endforeach()
    get_target_property(sources ${target} SOURCES)
    foreach(source IN LISTS sources)
        cmake_path(IS_ABSOLUTE source absolute)
        if(absolute OR NOT source MATCHES "\\.cpp$")
            continue()   # what is generated stays alone
        endif()
        cmake_path(GET source PARENT_PATH folder)
        if(folder STREQUAL "")
            set(folder ".")
        endif()
        string(MAKE_C_IDENTIFIER "in_${folder}" folder)
        if(NOT DEFINED group_${folder})
            set(group_${folder} ${folder})
        endif()
        set_source_files_properties(${source} PROPERTIES UNITY_GROUP ${group_${folder}})
    endforeach()
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_MODE GROUP)
    # of a class whose members are of types of its own file: another file is the main one here
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-subobject-linkage>)
endfunction()

# So much code at once makes much garbage, which g++ collects again and again: a sixth of its time. Where each core has 2 GiB, it begins
# with that later.
if(RELIDAR_UNITY AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    cmake_host_system_information(RESULT relidar_memory_mib QUERY TOTAL_PHYSICAL_MEMORY)
    cmake_host_system_information(RESULT relidar_cores QUERY NUMBER_OF_LOGICAL_CORES)
    math(EXPR relidar_core_mib "${relidar_memory_mib} / (${relidar_cores} + 1)")
    if(relidar_core_mib GREATER_EQUAL 2000)
        add_compile_options($<$<COMPILE_LANGUAGE:CXX>:--param=ggc-min-heapsize=524288>)
    endif()
endif()
