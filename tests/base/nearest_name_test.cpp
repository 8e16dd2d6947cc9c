// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/error.hpp>

#include <gtest/gtest.h>

#include "support/names.hpp"

namespace relidar {
namespace {

const std::vector<std::string> kPresets{"paper", "released", "default", "quick"};

TEST(DidYouMean, NamesWhatIsSpelledAlmostAlike) {
    EXPECT_THAT(format_name_suggestion("quik", kPresets), test::Names("quick"));
    EXPECT_THAT(format_name_suggestion("PAPR", kPresets, "'"), test::Names("'paper'"));
    EXPECT_THAT(format_name_suggestion("trian", {"render", "train"}), test::Names("train"));
    EXPECT_THAT(format_name_suggestion("maen", {"sh", "mean"}), test::Names("mean"))
        << "letters that have changed places are one error";
    EXPECT_THAT(format_name_suggestion("defualt", kPresets, "\""), test::Names("\"default\""));
    EXPECT_THAT(format_name_suggestion("iterations", {"train.iterations", "train.interval"}),
                test::Names("train.iterations"))
        << "a part is missing";
    EXPECT_THAT(format_name_suggestion("azimuth_ofset_deg", {"azimuth", "azimuth_offset_deg"}),
                test::Names("azimuth_offset_deg"))
        << "the nearest";
}

TEST(DidYouMean, SaysNothingWhereNothingResembles) {
    EXPECT_EQ(format_name_suggestion("fast", kPresets), "");
    EXPECT_EQ(format_name_suggestion("fast", kPresets, "", ", expected a preset"), ", expected a preset");
    EXPECT_EQ(format_name_suggestion("", kPresets), "");
    EXPECT_EQ(format_name_suggestion("quick", {}), "");
}

}  // namespace
}  // namespace relidar
