// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <algorithm>

#include <gtest/gtest.h>

#include <relidar/scene/device_scene.hpp>

namespace relidar::test {

/// Expects that all parameters have the same bits.
inline void expect_same_surfels(const Surfels& first, const Surfels& second) {
    ASSERT_EQ(first.parameters_used(), second.parameters_used());
    for (const SurfelParameterGroup& group : list_groups(first.parameters_used()))
        EXPECT_TRUE(std::ranges::equal(group.values(first), group.values(second))) << group.name;
}

}  // namespace relidar::test
