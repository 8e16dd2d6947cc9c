# SPDX-License-Identifier: Apache-2.0
# Kernels that need a newer glslang than Debian 12 has lie in the repository as SPIR-V too, beside their source: a .spirv file, words in
# hexadecimal digits below two lines of comments. A script for `cmake -P`, with
#   GLSLANG, INCLUDE, SOURCE, DEFINES   compiler, folder of the public headers, .comp file, -D flags
#   TEXT                                the .spirv file
# and one of
#   WRITE=ON              compiles SOURCE and writes TEXT: tools/dev/prebuild_kernels
#   WORDS                 writes an assembler's file with TEXT's words
#   neither               only checks TEXT
# TEXT names a hash of its source after the preprocessor, without directives and white space: comments and the version of glslang do not
# matter. Whatever reads TEXT fails where the source is another one by now.
cmake_minimum_required(VERSION 3.25)

execute_process(COMMAND ${GLSLANG} -E -I${INCLUDE} ${DEFINES} ${SOURCE} OUTPUT_VARIABLE source COMMAND_ERROR_IS_FATAL ANY)
string(REGEX REPLACE "(^|\n)[ \t]*#[^\n]*" "" source "${source}")
string(REGEX REPLACE "[ \t\r\n]" "" source "${source}")
string(SHA256 hash "${source}")

if(WRITE)
    set(binary ${TEXT}.part)
    execute_process(COMMAND ${GLSLANG} --quiet --target-env vulkan1.3 -I${INCLUDE} ${DEFINES} -o ${binary} ${SOURCE}
                    COMMAND_ERROR_IS_FATAL ANY)
    execute_process(COMMAND ${GLSLANG} --version OUTPUT_VARIABLE version)
    string(REGEX MATCH "[0-9]+\\.[0-9]+\\.[0-9]+" version "${version}")
    file(READ ${binary} words HEX)
    file(REMOVE ${binary})
    string(REGEX REPLACE "(..)(..)(..)(..)" "\\4\\3\\2\\1 " words "${words}")
    string(REPEAT "........ " 15 line)
    string(REGEX REPLACE "(${line})" "\\1\n" words "${words}")
    string(REGEX REPLACE " (\n|$)" "\n" words "${words}")
    set(made "glslang ${version}, source ${hash}, by tools/dev/prebuild_kernels")
    file(WRITE ${TEXT} "# SPDX-License-Identifier: Apache-2.0\n# ${made}\n${words}")
    message(STATUS "wrote ${TEXT}")
    return()
endif()

file(READ ${TEXT} text)
if(NOT text MATCHES "source ${hash},")
    message(FATAL_ERROR "reading ${TEXT}: it was made of another source, expected that of ${SOURCE}; run tools/dev/prebuild_kernels")
endif()
if(WORDS)
    string(REGEX REPLACE "#[^\n]*\n" "" text "${text}")
    string(REGEX REPLACE "([0-9a-f]+)[ \n]*" ".long 0x\\1\n" text "${text}")
    file(WRITE ${WORDS} "${text}")
endif()
