// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/error.hpp>

#include <gtest/gtest.h>

#include "support/names.hpp"

namespace relidar {
namespace {

const std::vector<std::string> kPresets{"paper", "released", "default", "quick"};

TEST(DidYouMean, NamesWhatIsSpelledAlmostAlike) {
    EXPECT_THAT(suggest_name("quik", kPresets), test::Names("quick"));
    EXPECT_THAT(suggest_name("PAPR", kPresets, "'"), test::Names("'paper'"));
    EXPECT_THAT(suggest_name("trian", {"render", "train"}), test::Names("train"));
    EXPECT_THAT(suggest_name("maen", {"sh", "mean"}), test::Names("mean"))
        << "letters that have changed places are one error";
    EXPECT_THAT(suggest_name("defualt", kPresets, "\""), test::Names("\"default\""));
    EXPECT_THAT(suggest_name("iterations", {"train.iterations", "train.interval"}),
                test::Names("train.iterations"))
        << "a part is missing";
    EXPECT_THAT(suggest_name("azimuth_ofset_deg", {"azimuth", "azimuth_offset_deg"}),
                test::Names("azimuth_offset_deg"))
        << "the nearest";
}

TEST(DidYouMean, SaysNothingWhereNothingResembles) {
    EXPECT_EQ(suggest_name("fast", kPresets), "");
    EXPECT_EQ(suggest_name("fast", kPresets, "", ", expected a preset"), ", expected a preset");
    EXPECT_EQ(suggest_name("", kPresets), "");
    EXPECT_EQ(suggest_name("quick", {}), "");
}

}  // namespace
}  // namespace relidar
