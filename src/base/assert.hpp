// SPDX-License-Identifier: Apache-2.0
// Checks of our own invariants: what a failed one compares is printed with file and line,
// and the process stops. Off in releases; the presets dev, ci and sanitize turn them on
// (RELIDAR_ASSERTS). What a caller or a file can get wrong is an Error instead.
#pragma once

/// RELIDAR_ASSERT_LE(a, b): a <= b, both printed where not. RELIDAR_ASSERT_EQ(a, b): a ==
/// b.
#define RELIDAR_ASSERT_LE(a, b) RELIDAR_ASSERT_THAT(a, <=, b)
#define RELIDAR_ASSERT_EQ(a, b) RELIDAR_ASSERT_THAT(a, ==, b)

#ifdef RELIDAR_ASSERTS

#include <cstdio>
#include <cstdlib>

#include <fmt/format.h>

#define RELIDAR_ASSERT_THAT(a, is, b)                                                                      \
    do {                                                                                                   \
        const auto relidar_a = (a);                                                                        \
        const auto relidar_b = (b);                                                                        \
        if (!(relidar_a is relidar_b)) {                                                                   \
            std::fputs(fmt::format("{}:{}: expected {} " #is " {}, found {} and {}\n", __FILE__, __LINE__, \
                                   #a, #b, relidar_a, relidar_b)                                           \
                           .c_str(),                                                                       \
                       stderr);                                                                            \
            std::abort();                                                                                  \
        }                                                                                                  \
    } while (false)

#else
#define RELIDAR_ASSERT_THAT(a, is, b) static_cast<void>(0)
#endif
