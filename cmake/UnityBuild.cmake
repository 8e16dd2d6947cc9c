# SPDX-License-Identifier: Apache-2.0
# relidar_unity(<target> [<folders>...]): with RELIDAR_UNITY, compiles several files
# together, so that headers are parsed and templates are instantiated only once. Each
# argument names folders that are compiled together ("train train/poses", "." for the
# target's own folder). Every other folder is compiled separately. Names in anonymous
# namespaces must therefore be unique among files that are compiled together. Files must
# still include all headers that they use, because preset dev compiles each file
# separately.
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
            continue()   # Generated files are compiled separately.
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
    # In a unity build, g++ warns about classes with members of types from an anonymous
    # namespace, because these types are defined in an included file. The warning is of no
    # use here.
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-subobject-linkage>)
endfunction()

# g++ collects garbage repeatedly during large unity builds, which takes a sixth of its
# time. If each core has 2 GiB, g++ starts to collect garbage later.
if(RELIDAR_UNITY AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    cmake_host_system_information(RESULT relidar_memory_mib QUERY TOTAL_PHYSICAL_MEMORY)
    cmake_host_system_information(RESULT relidar_cores QUERY NUMBER_OF_LOGICAL_CORES)
    math(EXPR relidar_core_mib "${relidar_memory_mib} / (${relidar_cores} + 1)")
    if(relidar_core_mib GREATER_EQUAL 2000)
        add_compile_options($<$<COMPILE_LANGUAGE:CXX>:--param=ggc-min-heapsize=524288>)
    endif()
endif()
