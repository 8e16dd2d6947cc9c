// SPDX-License-Identifier: Apache-2.0
// Assertions for internal invariants. A failed assertion prints both values with file and
// line, and aborts the program. Only the presets dev, ci and sanitize enable assertions
// (RELIDAR_ASSERTS). Errors in files or arguments throw an Error instead.
#pragma once

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
