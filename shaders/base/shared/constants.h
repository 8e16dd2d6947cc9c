// SPDX-License-Identifier: Apache-2.0
// Names and ids of the specialisation constants of all kernels. A shader declares one
// with RELIDAR_CONSTANT(type, name, value) (base/kernel.glsl). The host sets it as
// ConstantId::name (src/gpu/kernel.hpp). `relidar-dev pipelines` prints it by name.
#ifndef RELIDAR_INCLUDED_BASE_SHARED_CONSTANTS_H
#define RELIDAR_INCLUDED_BASE_SHARED_CONSTANTS_H

// clang-format off
#define RELIDAR_CONSTANTS(X) \
    X(WORKGROUP_SIZE, 0u)      /* threads of a workgroup */ \
    X(CHUNK, 1u)               /* hits sorted at a time */ \
    X(BOXES, 2u)               /* proxies: 0: triangles; 1: boxes for a driver; 2: boxes for the software structure */ \
    X(SH_PER_SURFEL, 3u)       /* harmonics are evaluated 1: once a surfel; 0: a hit */ \
    X(TOGETHER, 4u)            /* 1: rays of a subgroup walk the tree together; 2: and load surfels for each other */ \
    X(COUNT_VISITS, 5u)        /* 1: nodes opened and surfels tested are counted */ \
    X(GATHER, 6u)              /* 1: write a record of each hit, for backward/gather; 0: add its gradient with atomics */ \
    X(COALESCED_ATOMICS, 7u)   /* 1: neighbouring lanes add the floats of one hit; 0: each lane those of its own */ \
    X(SINGLE_DROP_LOGIT, 8u)   /* 1: hit logits are 0, whatever the scene holds */ \
    X(PRIMITIVE, 9u)           /* number of a row of relidar/scene/primitives.h */ \
    X(NORMAL, 10u)             /* 1: blended normal too */ \
    X(KEY_WORDS, 11u)          /* 32-bit words of a sort key */ \
    X(UNTIL_DONE, 12u)         /* 1: a single workgroup repeats until no work is left */ \
    X(STAGED, 13u)             /* 1: threads of a workgroup move harmonics together through shared memory */ \
    X(PER_FLOAT, 14u)          /* 1: one thread per float; 0: one thread per row */ \
    X(TAPS, 15u)               /* weights of a convolution for two channels: 1 or 9 */ \
    X(PIXELS, 16u)             /* pixels per thread */ \
    X(LANES, 17u)              /* lanes of a subgroup */ \
    X(LIKELIHOOD, 18u)         /* 1: also compute the likelihood of measured ranges */ \
    X(MODE, 19u)               /* 1: also compute the heaviest surface of each ray */
// clang-format on

#endif
