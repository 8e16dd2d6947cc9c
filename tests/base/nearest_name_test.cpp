// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/error.hpp>

#include <gtest/gtest.h>

namespace relidar {
namespace {

const std::vector<std::string> kPresets{"paper", "released", "default", "quick"};

TEST(DidYouMean, NamesWhatIsSpelledAlmostAlike) {
    EXPECT_EQ(suggest_name("quik", kPresets), ", did you mean quick?");
    EXPECT_EQ(suggest_name("PAPR", kPresets, "'"), ", did you mean 'paper'?");
    EXPECT_EQ(suggest_name("trian", {"render", "train"}), ", did you mean train?");
    EXPECT_EQ(suggest_name("maen", {"sh", "mean"}), ", did you mean mean?")
        << "letters that have changed places are one error";
    EXPECT_EQ(suggest_name("defualt", kPresets, "\""), ", did you mean \"default\"?");
    EXPECT_EQ(suggest_name("iterations", {"train.iterations", "train.interval"}),
              ", did you mean train.iterations?")
        << "a part is missing";
    EXPECT_EQ(suggest_name("azimuth_ofset_deg", {"azimuth", "azimuth_offset_deg"}),
              ", did you mean azimuth_offset_deg?")
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
