// SPDX-License-Identifier: Apache-2.0
// Lists the names and ids of the specialisation constants of all kernels. A shader
// declares a constant with RELIDAR_CONSTANT(type, name, value). The host sets the
// constant with SpecialisationConstantId::name (src/gpu/kernel.hpp).
#ifndef RELIDAR_INCLUDED_BASE_SHARED_CONSTANTS_H
#define RELIDAR_INCLUDED_BASE_SHARED_CONSTANTS_H

// clang-format off
#define RELIDAR_CONSTANTS(X) \
    X(WORKGROUP_SIZE, 0u)      /* threads of a workgroup */ \
    X(CHUNK, 1u)               /* hits sorted at a time */ \
    X(BOXES, 2u)               /* proxies: 0: triangles; 1: driver boxes; 2: boxes of the software tree */ \
    X(SH_PER_SURFEL, 3u)       /* 1: harmonics are evaluated once per surfel; 0: once per hit */ \
    X(TOGETHER, 4u)            /* 1: a subgroup traverses the tree together; 2: and shares loads */ \
    X(COUNT_VISITS, 5u)        /* 1: count the opened nodes and the tested surfels */ \
    X(GATHER, 6u)              /* gradients of hits: 1: records for backward/gather; 0: atomics */ \
    X(COALESCED_ATOMICS, 7u)   /* 1: neighbouring lanes add the floats of one hit together */ \
    X(SINGLE_DROP_LOGIT, 8u)   /* 1: all hit logits count as 0 */ \
    X(PRIMITIVE, 9u)           /* index of a row in relidar/scene/primitives.h */ \
    X(NORMAL, 10u)             /* 1: also compute the blended normal */ \
    X(KEY_WORDS, 11u)          /* 32-bit words of a sort key */ \
    X(UNTIL_DONE, 12u)         /* 1: a single workgroup repeats until no work is left */ \
    X(STAGED, 13u)             /* 1: threads of a workgroup move harmonics together through shared memory */ \
    X(ONE_THREAD_PER_FLOAT, 14u) /* 1: one thread per float; 0: one thread per row */ \
    X(TAPS, 15u)               /* weights of a convolution for two channels: 1 or 9 */ \
    X(PIXELS, 16u)             /* pixels per thread */ \
    X(LANES, 17u)              /* lanes of a subgroup */ \
    X(LIKELIHOOD, 18u)         /* 1: also compute the likelihood of measured ranges */ \
    X(MODE, 19u)               /* 1: also compute the heaviest surface of each ray */
// clang-format on

#endif
