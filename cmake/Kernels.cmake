# SPDX-License-Identifier: Apache-2.0
# add_kernel(stage/stem [TRACES] [ACCUMULATES] [IMAGES]): compiles shaders/<stage>/<stem>.comp to SPIR-V and embeds it in the library.
#   TRACES       built once per traversal backend: @ray_query, @software_bvh, @brute_force
#   ACCUMULATES  built once with the device's float atomics and once with compare-and-swap: suffix _atomics, _swap
#   IMAGES       built once for images of floats and once for images of halves: @halves
#   MATRICES     needs VK_KHR_cooperative_matrix; where this glslang does not know it, made of the .spirv files beside the source
# embed_kernels(<target>): generates the table that relidar::embedded_kernels() returns, so that there is nothing to find at run time, and
#   kernel_params.hpp, by which the compiler knows each kernel's parameter struct.
find_program(RELIDAR_GLSLANG glslangValidator REQUIRED)
find_program(RELIDAR_SPIRV_VAL spirv-val)
set_property(GLOBAL PROPERTY RELIDAR_KERNELS "")

# RELIDAR_GLSLANG_HAS_MATRICES: whether glslang knows VK_KHR_cooperative_matrix; glslang 14 was the first.
set(probe ${CMAKE_BINARY_DIR}/kernels/matrix_probe)
file(WRITE ${probe}.comp [[
#version 460
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
layout(local_size_x = 32) in;
shared float sums[256];
void main() {
    coopmat<float, gl_ScopeSubgroup, 16, 16, gl_MatrixUseAccumulator> sum;
    coopMatStore(sum, sums, 0, 16, gl_CooperativeMatrixLayoutRowMajor);
}
]])
execute_process(COMMAND ${RELIDAR_GLSLANG} --target-env vulkan1.3 -o ${probe}.spv ${probe}.comp
                RESULT_VARIABLE result OUTPUT_QUIET ERROR_QUIET)
if(result EQUAL 0 AND RELIDAR_SPIRV_VAL)
    execute_process(COMMAND ${RELIDAR_SPIRV_VAL} --target-env vulkan1.3 ${probe}.spv RESULT_VARIABLE result OUTPUT_QUIET ERROR_QUIET)
endif()
if(result EQUAL 0)
    set(RELIDAR_GLSLANG_HAS_MATRICES ON)
else()
    set(RELIDAR_GLSLANG_HAS_MATRICES OFF)
endif()

function(_relidar_compile name source defines)
    string(REGEX REPLACE "[^a-zA-Z0-9]" "_" symbol ${name})
    set(spirv ${CMAKE_BINARY_DIR}/kernels/${symbol}.spv)
    set(flags --target-env vulkan1.3 -I${PROJECT_SOURCE_DIR}/include $<$<BOOL:${RELIDAR_SHADER_DEBUG}>:-g>)
    set(check "")
    if(RELIDAR_SPIRV_VAL)
        set(check COMMAND ${RELIDAR_SPIRV_VAL} --target-env vulkan1.3 --scalar-block-layout ${spirv})
    endif()
    add_custom_command(
        OUTPUT ${spirv}
        COMMAND ${RELIDAR_GLSLANG} --quiet ${flags} ${defines} --depfile ${spirv}.d -o ${spirv} ${source}
        ${check}
        DEPENDS ${source}
        DEPFILE ${spirv}.d
        COMMENT "Kernel ${name}"
        COMMAND_EXPAND_LISTS VERBATIM)
    set_property(GLOBAL APPEND PROPERTY RELIDAR_KERNELS "${name}|${symbol}|.incbin|${spirv}")
endfunction()

# The same of the .spirv file of a kernel that this glslang cannot compile.
function(_relidar_take_prebuilt name source defines)
    string(REGEX REPLACE "[^a-zA-Z0-9]" "_" symbol ${name})
    set(words ${CMAKE_BINARY_DIR}/kernels/${symbol}.s)
    set(text ${PROJECT_SOURCE_DIR}/shaders/${name}.spirv)
    set(folder ${PROJECT_SOURCE_DIR}/shaders)
    file(GLOB includes CONFIGURE_DEPENDS ${folder}/common/* ${folder}/shared/* ${folder}/refine/*.glsl
         ${PROJECT_SOURCE_DIR}/include/relidar/shared/*)
    add_custom_command(
        OUTPUT ${words}
        COMMAND ${CMAKE_COMMAND} -DGLSLANG=${RELIDAR_GLSLANG} -DINCLUDE=${PROJECT_SOURCE_DIR}/include -DSOURCE=${source}
            -DDEFINES=${defines} -DTEXT=${text} -DWORDS=${words} -P ${PROJECT_SOURCE_DIR}/cmake/PrebuiltKernel.cmake
        DEPENDS ${source} ${includes} ${text} ${PROJECT_SOURCE_DIR}/cmake/PrebuiltKernel.cmake
        COMMENT "Kernel ${name}"
        VERBATIM)
    set_property(GLOBAL APPEND PROPERTY RELIDAR_KERNELS "${name}|${symbol}|.include|${words}")
endfunction()

function(add_kernel path)
    cmake_parse_arguments(KERNEL "TRACES;ACCUMULATES;IMAGES;MATRICES" "" "" ${ARGN})
    set(source ${PROJECT_SOURCE_DIR}/shaders/${path}.comp)
    if(KERNEL_MATRICES AND NOT RELIDAR_GLSLANG_HAS_MATRICES)
        _relidar_take_prebuilt(${path} ${source} "")
        _relidar_take_prebuilt(${path}@halves ${source} -DRELIDAR_HALVES)
        return()
    endif()
    set(variants "@|")  # no backend: "stem", or "stem@_atomics" and "stem@_swap"
    if(KERNEL_TRACES)
        set(variants "@ray_query|-DRELIDAR_TRAVERSAL_RAY_QUERY" "@software_bvh|-DRELIDAR_TRAVERSAL_SOFTWARE_BVH" "@brute_force|")
    endif()
    if(KERNEL_IMAGES)
        _relidar_compile(${path}@halves ${source} "-DRELIDAR_HALVES")
    endif()
    foreach(variant IN LISTS variants)
        string(REGEX REPLACE "\\|.*" "" suffix "${variant}")
        string(REGEX REPLACE ".*\\|" "" define "${variant}")
        if(KERNEL_ACCUMULATES)
            _relidar_compile(${path}${suffix}_atomics ${source} "${define};-DRELIDAR_FLOAT_ATOMICS")
            _relidar_compile(${path}${suffix}_swap ${source} "${define}")
        elseif(KERNEL_TRACES)
            _relidar_compile(${path}${suffix} ${source} "${define}")
        else()
            _relidar_compile(${path} ${source} "${define}")
        endif()
    endforeach()
endfunction()

# kernel_params.hpp: which parameter struct each shader declares, so that a kernel with another one does not compile.
function(_relidar_list_params)
    file(GLOB_RECURSE shaders CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/shaders/*.comp)
    set(rows "")
    foreach(shader IN LISTS shaders)
        set_property(DIRECTORY ${PROJECT_SOURCE_DIR} APPEND PROPERTY CMAKE_CONFIGURE_DEPENDS ${shader})
        file(STRINGS ${shader} declaration REGEX "^RELIDAR_PARAMS\\(")
        string(REGEX REPLACE "^RELIDAR_PARAMS\\(([A-Za-z0-9]+)\\).*" "\\1" params "${declaration}")
        file(RELATIVE_PATH name ${PROJECT_SOURCE_DIR}/shaders ${shader})
        string(REGEX REPLACE "\\.comp$" "" name ${name})
        string(APPEND rows "    {\"${name}\", \"${params}\"},\n")
    endforeach()
    file(CONFIGURE OUTPUT ${CMAKE_BINARY_DIR}/kernels/kernel_params.hpp @ONLY CONTENT [[// Generated by cmake/Kernels.cmake.
#pragma once
#include <string_view>
namespace relidar {
struct KernelParams { std::string_view kernel, params; };
inline constexpr KernelParams kKernelParams[] = {
@rows@};
}  // namespace relidar
]])
endfunction()

function(embed_kernels target)
    _relidar_list_params()
    target_include_directories(${target} PRIVATE ${CMAKE_BINARY_DIR}/kernels)
    get_property(kernels GLOBAL PROPERTY RELIDAR_KERNELS)
    set(embeddings "")
    set(rows "")
    set(files "")
    foreach(kernel IN LISTS kernels)
        string(REPLACE "|" ";" parts "${kernel}")
        list(GET parts 0 name)
        list(GET parts 1 symbol)
        list(GET parts 2 directive)
        list(GET parts 3 file)
        string(APPEND embeddings "RELIDAR_EMBED(${symbol}, \"${directive} \\\"${file}\\\"\")\n")
        string(APPEND rows "    {\"${name}\", {${symbol}_begin, ${symbol}_end}},\n")
        list(APPEND files ${file})
    endforeach()
    set(source ${CMAKE_BINARY_DIR}/kernels/embedded_kernels.cpp)
    file(CONFIGURE OUTPUT ${source} @ONLY CONTENT [[// Generated by cmake/Kernels.cmake.
#include <cstdint>
#include "gpu/kernel.hpp"
// The assembler takes the words from their file: a compiler would read millions of numbers.
#define RELIDAR_EMBED(symbol, words) \
    asm(".pushsection .rodata\n.balign 4\n" #symbol "_begin:\n" words "\n" #symbol "_end:\n.popsection"); \
    extern "C" __attribute__((visibility("hidden"))) const std::uint32_t symbol##_begin[], symbol##_end[];
@embeddings@
namespace relidar {
namespace { const EmbeddedKernel kKernels[] = {
@rows@}; }
std::span<const EmbeddedKernel> embedded_kernels() { return kKernels; }
}  // namespace relidar
]])
    set_source_files_properties(${source} PROPERTIES OBJECT_DEPENDS "${files}")
    target_sources(${target} PRIVATE ${source})
endfunction()
