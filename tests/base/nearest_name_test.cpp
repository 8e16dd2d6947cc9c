// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/error.hpp>

#include <gtest/gtest.h>

namespace relidar {
namespace {

const std::vector<std::string> kPresets{"paper", "released", "default", "quick"};

TEST(DidYouMean, NamesWhatIsSpelledAlmostAlike) {
    EXPECT_EQ(did_you_mean("quik", kPresets), ", did you mean quick?");
    EXPECT_EQ(did_you_mean("PAPR", kPresets, "'"), ", did you mean 'paper'?");
    EXPECT_EQ(did_you_mean("trian", {"render", "train"}), ", did you mean train?");
    EXPECT_EQ(did_you_mean("maen", {"sh", "mean"}), ", did you mean mean?")
        << "letters that have changed places are one error";
    EXPECT_EQ(did_you_mean("defualt", kPresets, "\""), ", did you mean \"default\"?");
    EXPECT_EQ(did_you_mean("iterations", {"train.iterations", "train.interval"}),
              ", did you mean train.iterations?")
        << "a part is missing";
    EXPECT_EQ(did_you_mean("azimuth_ofset_deg", {"azimuth", "azimuth_offset_deg"}),
              ", did you mean azimuth_offset_deg?")
        << "the nearest";
}

TEST(DidYouMean, SaysNothingWhereNothingResembles) {
    EXPECT_EQ(did_you_mean("fast", kPresets), "");
    EXPECT_EQ(did_you_mean("fast", kPresets, "", ", expected a preset"), ", expected a preset");
    EXPECT_EQ(did_you_mean("", kPresets), "");
    EXPECT_EQ(did_you_mean("quick", {}), "");
}

}  // namespace
}  // namespace relidar
