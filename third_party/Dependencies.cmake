# SPDX-License-Identifier: Apache-2.0
# Where each dependency comes from: one line a dependency, each becomes one target `relidar::dep_<name>`.
# Why each is here, which versions and which licence: README.md beside this file.
#
# Read by relidar's own build and, installed as relidarDependencies.cmake, by find_package(relidar), which sets
# RELIDAR_FOR_PACKAGE: there, what only building needs may be absent.

option(RELIDAR_FETCH_DEPENDENCIES "Download header-only dependencies that are not installed, at pinned versions" OFF)

set(RELIDAR_MISSING_DEPENDENCIES "")   # apt names of what was not found, for one message at the end

# relidar_dependency(<name>
#     APT <package>                Debian package, for the message
#     [PACKAGE <name>]             1st: find_package(<name> [COMPONENTS...]), taking every target of TARGETS that exists
#     [COMPONENTS <name>...] [TARGETS <target>...]
#     [HEADER <file>] [LIBRARY <name>...]   2nd: find_path and find_library
#     [FETCH <url> <tag> <folder>] 3rd: with RELIDAR_FETCH_DEPENDENCIES, headers of that folder at that tag
#     [DEFINE <macro>...] [LINK <target>...] [FETCH_DEFINE <macro>...]
#     [BUILD_ONLY])                an installed relidar does not need it
function(relidar_dependency name)
    cmake_parse_arguments(PARSE_ARGV 1 dep "BUILD_ONLY" "APT;PACKAGE;HEADER" "COMPONENTS;TARGETS;LIBRARY;FETCH;FETCH_DEFINE;DEFINE;LINK")
    set(target relidar::dep_${name})
    if(TARGET ${target})
        return()
    endif()
    add_library(${target} INTERFACE IMPORTED GLOBAL)
    # cmake/Package.cmake reads them
    set_target_properties(${target} PROPERTIES RELIDAR_DEBIAN_PACKAGE ${dep_APT} RELIDAR_BUILD_ONLY ${dep_BUILD_ONLY})
    target_compile_definitions(${target} INTERFACE ${dep_DEFINE})
    target_link_libraries(${target} INTERFACE ${dep_LINK})

    relidar_dependency_from_package(found)
    if(NOT found AND dep_HEADER)
        relidar_dependency_from_files(found)
    endif()
    if(NOT found AND dep_FETCH AND RELIDAR_FETCH_DEPENDENCIES)
        relidar_dependency_from_source(found)
    endif()
    if(NOT found AND NOT (RELIDAR_FOR_PACKAGE AND dep_BUILD_ONLY))
        list(APPEND RELIDAR_MISSING_DEPENDENCIES ${dep_APT})
        set(RELIDAR_MISSING_DEPENDENCIES ${RELIDAR_MISSING_DEPENDENCIES} PARENT_SCOPE)
    endif()
endfunction()

# The three sources below see the dep_ variables and `target` of relidar_dependency and set `result` to ON or OFF.
function(relidar_dependency_from_package result)
    set(${result} OFF PARENT_SCOPE)
    if(NOT dep_PACKAGE)
        return()
    endif()
    set(CMAKE_MESSAGE_LOG_LEVEL WARNING)   # some packages chat even when QUIET
    if(dep_COMPONENTS)
        list(PREPEND dep_COMPONENTS COMPONENTS)
    endif()
    find_package(${dep_PACKAGE} QUIET GLOBAL ${dep_COMPONENTS})
    foreach(candidate IN LISTS dep_TARGETS)
        if(TARGET ${candidate})
            target_link_libraries(${target} INTERFACE ${candidate})
            set(${result} ON PARENT_SCOPE)
            return()
        endif()
    endforeach()
endfunction()

function(relidar_dependency_from_files result)
    find_path(RELIDAR_${name}_INCLUDE ${dep_HEADER})
    mark_as_advanced(RELIDAR_${name}_INCLUDE)
    set(${result} OFF PARENT_SCOPE)
    if(NOT RELIDAR_${name}_INCLUDE)
        return()
    endif()
    if(dep_LIBRARY)
        find_library(RELIDAR_${name}_LIBRARY NAMES ${dep_LIBRARY})
        mark_as_advanced(RELIDAR_${name}_LIBRARY)
        if(NOT RELIDAR_${name}_LIBRARY)
            return()
        endif()
        target_link_libraries(${target} INTERFACE ${RELIDAR_${name}_LIBRARY})
    endif()
    target_include_directories(${target} SYSTEM INTERFACE ${RELIDAR_${name}_INCLUDE})
    set(${result} ON PARENT_SCOPE)
endfunction()

function(relidar_dependency_from_source result)
    include(FetchContent)
    list(GET dep_FETCH 0 url)
    list(GET dep_FETCH 1 tag)
    list(GET dep_FETCH 2 folder)
    # A SOURCE_SUBDIR without CMakeLists.txt: download, do not build.
    FetchContent_Declare(relidar_${name} GIT_REPOSITORY ${url} GIT_TAG ${tag} GIT_SHALLOW ON SOURCE_SUBDIR relidar-headers-only)
    FetchContent_MakeAvailable(relidar_${name})
    target_include_directories(${target} SYSTEM INTERFACE ${relidar_${name}_SOURCE_DIR}/${folder})
    target_compile_definitions(${target} INTERFACE ${dep_FETCH_DEFINE})
    set(${result} ON PARENT_SCOPE)
endfunction()

# --- the library -----------------------------------------------------------------------------------------------------
relidar_dependency(glm APT libglm-dev PACKAGE glm TARGETS glm::glm HEADER glm/glm.hpp
    FETCH https://github.com/g-truc/glm.git 0.9.9.8 .)
relidar_dependency(fmt APT libfmt-dev PACKAGE fmt TARGETS fmt::fmt
    FETCH https://github.com/fmtlib/fmt.git 9.1.0 include FETCH_DEFINE FMT_HEADER_ONLY)
relidar_dependency(vulkan_headers BUILD_ONLY APT libvulkan-dev PACKAGE VulkanHeaders TARGETS Vulkan::Headers HEADER vulkan/vulkan.h
    DEFINE VK_NO_PROTOTYPES FETCH https://github.com/KhronosGroup/Vulkan-Headers.git v1.3.239 include)
relidar_dependency(volk APT libvulkan-volk-dev BUILD_ONLY HEADER volk.h
    LINK relidar::dep_vulkan_headers ${CMAKE_DL_LIBS} FETCH https://github.com/zeux/volk.git sdk-1.3.239.0 .)
relidar_dependency(nanoflann APT libnanoflann-dev BUILD_ONLY PACKAGE nanoflann TARGETS nanoflann::nanoflann HEADER nanoflann.hpp
    FETCH https://github.com/jlblancoc/nanoflann.git v1.4.3 include)
relidar_dependency(eigen APT libeigen3-dev BUILD_ONLY PACKAGE Eigen3 TARGETS Eigen3::Eigen HEADER Eigen/Core
    FETCH https://gitlab.com/libeigen/eigen.git 3.4.0 .)
relidar_dependency(nlohmann_json APT nlohmann-json3-dev BUILD_ONLY PACKAGE nlohmann_json TARGETS nlohmann_json::nlohmann_json
    HEADER nlohmann/json.hpp FETCH https://github.com/nlohmann/json.git v3.11.2 include)
relidar_dependency(tomlplusplus APT libtomlplusplus-dev PACKAGE tomlplusplus TARGETS tomlplusplus::tomlplusplus
    HEADER toml++/toml.h FETCH https://github.com/marzer/tomlplusplus.git v3.3.0 include)
relidar_dependency(pugixml APT libpugixml-dev PACKAGE pugixml TARGETS pugixml::pugixml pugixml HEADER pugixml.hpp LIBRARY pugixml)
relidar_dependency(tbb APT libtbb-dev PACKAGE TBB COMPONENTS tbb TARGETS TBB::tbb)
relidar_dependency(png APT libpng-dev PACKAGE PNG TARGETS PNG::PNG)
relidar_dependency(openexr APT libopenexr-dev PACKAGE OpenEXR TARGETS OpenEXR::OpenEXR)
relidar_dependency(zlib APT zlib1g-dev PACKAGE ZLIB TARGETS ZLIB::ZLIB)
relidar_dependency(zip APT libzip-dev HEADER zip.h LIBRARY zip)   # Debian 12's CMake package also needs the program zipcmp
# of dataset readers
relidar_dependency(protozero APT libprotozero-dev BUILD_ONLY HEADER protozero/pbf_reader.hpp
    FETCH https://github.com/mapbox/protozero.git v1.7.1 include)
relidar_dependency(simdjson APT libsimdjson-dev PACKAGE simdjson TARGETS simdjson::simdjson HEADER simdjson.h LIBRARY simdjson)
relidar_dependency(flatbuffers APT libflatbuffers-dev BUILD_ONLY HEADER flatbuffers/flatbuffers.h
    FETCH https://github.com/google/flatbuffers.git v2.0.8 include)
relidar_dependency(lz4 APT liblz4-dev HEADER lz4frame.h LIBRARY lz4)
relidar_dependency(zstd APT libzstd-dev HEADER zstd.h LIBRARY zstd)
# of the reader of ROS bags: left out where one of them is missing; an installed relidar says whether it was built with it
if(RELIDAR_BAGS)
    find_path(RELIDAR_sqlite3_INCLUDE sqlite3.h)
    find_path(RELIDAR_bzip2_INCLUDE bzlib.h)
    if(RELIDAR_FOR_PACKAGE OR (RELIDAR_sqlite3_INCLUDE AND RELIDAR_bzip2_INCLUDE))
        relidar_dependency(sqlite3 APT libsqlite3-dev HEADER sqlite3.h LIBRARY sqlite3)
        relidar_dependency(bzip2 APT libbz2-dev HEADER bzlib.h LIBRARY bz2)
    else()
        message(STATUS "relidar: ROS bags are not read (needs libsqlite3-dev libbz2-dev)")
        set(RELIDAR_BAGS OFF)
    endif()
endif()
if(RELIDAR_PCAP AND RELIDAR_BAGS)
    find_path(RELIDAR_pcap_INCLUDE pcap/pcap.h)
    if(RELIDAR_FOR_PACKAGE OR RELIDAR_pcap_INCLUDE)
        relidar_dependency(pcap APT libpcap-dev HEADER pcap/pcap.h LIBRARY pcap)
    else()
        message(STATUS "relidar: captures of packets are not read (needs libpcap-dev)")
        set(RELIDAR_PCAP OFF)
    endif()
else()
    set(RELIDAR_PCAP OFF)
endif()

# of positions on the earth
if(RELIDAR_PROJ)
    find_path(RELIDAR_proj_INCLUDE proj.h)
    if(RELIDAR_FOR_PACKAGE OR RELIDAR_proj_INCLUDE)
        relidar_dependency(proj APT libproj-dev HEADER proj.h LIBRARY proj)
    else()
        message(STATUS "relidar: latitudes and longitudes are not converted (needs libproj-dev)")
        set(RELIDAR_PROJ OFF)
    endif()
endif()

# --- the command line tool -------------------------------------------------------------------------------------------
if(RELIDAR_BUILD_TOOLS AND NOT RELIDAR_FOR_PACKAGE)
    relidar_dependency(cli11 APT libcli11-dev BUILD_ONLY PACKAGE CLI11 TARGETS CLI11::CLI11 HEADER CLI/CLI.hpp
        FETCH https://github.com/CLIUtils/CLI11.git v2.3.1 include)
endif()
if((RELIDAR_BUILD_TOOLS OR RELIDAR_FUZZ) AND NOT RELIDAR_FOR_PACKAGE)
    find_path(RELIDAR_beast_INCLUDE boost/beast/websocket/stream.hpp)
    if(RELIDAR_VIEW AND RELIDAR_beast_INCLUDE)
        relidar_dependency(beast APT libboost-dev BUILD_ONLY HEADER boost/beast/websocket/stream.hpp)
    elseif(RELIDAR_VIEW)
        message(STATUS "relidar: `relidar view` is left out (needs Boost.Beast: libboost-dev)")
        set(RELIDAR_VIEW OFF)
    endif()
endif()

# --- the service of the tool: left out where something of it is missing ------------------------------------------------
if((RELIDAR_BUILD_TOOLS OR RELIDAR_FUZZ) AND RELIDAR_SERVE AND NOT RELIDAR_FOR_PACKAGE)
    find_program(RELIDAR_PROTOC protoc)
    find_program(RELIDAR_GRPC_PLUGIN grpc_cpp_plugin)
    find_library(RELIDAR_REFLECTION_LIBRARY grpc++_reflection)
    mark_as_advanced(RELIDAR_PROTOC RELIDAR_GRPC_PLUGIN RELIDAR_REFLECTION_LIBRARY)
    find_package(PkgConfig QUIET)
    if(PKG_CONFIG_FOUND)   # not gRPC's CMake package: Debian 12's stops with an error in its own modules
        pkg_check_modules(RELIDAR_GRPC QUIET IMPORTED_TARGET GLOBAL grpc++ protobuf)
    endif()
    if(RELIDAR_PROTOC AND RELIDAR_GRPC_PLUGIN AND RELIDAR_REFLECTION_LIBRARY AND TARGET PkgConfig::RELIDAR_GRPC AND RELIDAR_beast_INCLUDE)
        relidar_dependency(beast APT libboost-dev BUILD_ONLY HEADER boost/beast/websocket/stream.hpp)
        relidar_dependency(grpc APT libgrpc++-dev BUILD_ONLY HEADER grpcpp/grpcpp.h
            LINK -Wl,--as-needed ${RELIDAR_REFLECTION_LIBRARY} PkgConfig::RELIDAR_GRPC)   # of the many libraries that it names few are used
    else()
        message(STATUS "relidar: no `relidar serve` (needs libboost-dev libgrpc++-dev protobuf-compiler-grpc libprotobuf-dev; tools/dev/setup --serve)")
    endif()
endif()

# --- many processes: left out where MPI is missing -----------------------------------------------------------------------
if(RELIDAR_BUILD_TOOLS AND RELIDAR_MPI AND NOT RELIDAR_FOR_PACKAGE)
    find_package(MPI QUIET COMPONENTS C)
    if(MPI_C_FOUND)
        relidar_dependency(mpi APT libopenmpi-dev BUILD_ONLY PACKAGE MPI COMPONENTS C TARGETS MPI::MPI_C
            DEFINE OMPI_SKIP_MPICXX MPICH_SKIP_MPICXX)   # its C functions, not the C++ ones of long ago
    else()
        message(STATUS "relidar: `mpirun relidar train --blocks` is left out (needs MPI: libopenmpi-dev)")
    endif()
endif()

# --- the Python module -----------------------------------------------------------------------------------------------
if(RELIDAR_PYTHON AND NOT RELIDAR_FOR_PACKAGE)
    # The first python3 in PATH that has numpy: a machine may have several, of which the system's own is the one that packages serve.
    function(relidar_has_numpy result candidate)
        execute_process(COMMAND ${candidate} -c "import numpy" RESULT_VARIABLE status OUTPUT_QUIET ERROR_QUIET)
        if(NOT status EQUAL 0)
            set(${result} FALSE PARENT_SCOPE)
        endif()
    endfunction()
    find_program(Python_EXECUTABLE NAMES python3 VALIDATOR relidar_has_numpy)
    if(NOT Python_EXECUTABLE)
        list(APPEND RELIDAR_MISSING_DEPENDENCIES python3-numpy)
    endif()
    find_package(Python QUIET GLOBAL COMPONENTS Interpreter Development.Module)
    if(NOT Python_Development.Module_FOUND)
        list(APPEND RELIDAR_MISSING_DEPENDENCIES python3-dev)
    endif()
    relidar_dependency(pybind11 APT pybind11-dev PACKAGE pybind11 TARGETS pybind11::module)
endif()

# --- tests -----------------------------------------------------------------------------------------------------------
if((RELIDAR_BUILD_TESTS OR RELIDAR_FUZZ) AND NOT RELIDAR_FOR_PACKAGE)
    relidar_dependency(gtest APT libgtest-dev PACKAGE GTest TARGETS GTest::gtest)
    relidar_dependency(gmock APT libgmock-dev PACKAGE GTest TARGETS GTest::gmock LINK relidar::dep_gtest)
endif()
if(RELIDAR_BUILD_TESTS AND NOT RELIDAR_FOR_PACKAGE)
    # Embree 3 and 4 both call their target `embree`; only the header's folder differs.
    find_package(embree QUIET GLOBAL)
    relidar_dependency(embree APT libembree-dev PACKAGE embree TARGETS embree)
endif()

if(RELIDAR_MISSING_DEPENDENCIES AND NOT RELIDAR_FOR_PACKAGE)
    list(REMOVE_DUPLICATES RELIDAR_MISSING_DEPENDENCIES)
    list(JOIN RELIDAR_MISSING_DEPENDENCIES " " missing)
    message(FATAL_ERROR "relidar: not found (names as in Debian): ${missing}. Run tools/dev/setup, or install them; "
        "-DRELIDAR_FETCH_DEPENDENCIES=ON downloads those that are header-only.")
endif()
