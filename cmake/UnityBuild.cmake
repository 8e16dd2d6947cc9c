# SPDX-License-Identifier: Apache-2.0
# relidar_unity(<target>): with RELIDAR_UNITY, the files of a folder of the target are compiled together, eight at a time, so that headers
# are parsed and templates are made once for eight files. Names in anonymous namespaces are therefore unique in a folder. Files say
# what they include all the same: preset dev compiles each alone.
function(relidar_unity target)
    if(NOT RELIDAR_UNITY)
        return()
    endif()
    get_target_property(sources ${target} SOURCES)
    set(folders "")
    foreach(source IN LISTS sources)
        cmake_path(IS_ABSOLUTE source absolute)
        if(absolute OR NOT source MATCHES "\\.cpp$")
            continue()   # what is generated stays alone
        endif()
        cmake_path(GET source PARENT_PATH folder)
        string(MAKE_C_IDENTIFIER "in_${folder}" folder)
        list(APPEND folders ${folder})
        list(APPEND files_${folder} ${source})
    endforeach()
    list(REMOVE_DUPLICATES folders)
    foreach(folder IN LISTS folders)
        set(place 0)
        foreach(source IN LISTS files_${folder})
            math(EXPR group "${place} / 8")
            set_source_files_properties(${source} PROPERTIES UNITY_GROUP ${folder}_${group})
            math(EXPR place "${place} + 1")
        endforeach()
    endforeach()
    set_target_properties(${target} PROPERTIES UNITY_BUILD ON UNITY_BUILD_MODE GROUP)
    # of a class whose members are of types of its own file: another file is the main one here
    target_compile_options(${target} PRIVATE $<$<COMPILE_LANG_AND_ID:CXX,GNU>:-Wno-subobject-linkage>)
endfunction()
