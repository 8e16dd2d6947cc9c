// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/error.hpp>

#include "support/names.hpp"

namespace relidar {
namespace {

const std::vector<std::string> kPresets{"paper", "released", "default", "quick"};

TEST(DidYouMean, NamesWhatIsSpelledAlmostAlike) {
    EXPECT_THAT(did_you_mean("quik", kPresets), test::Names("quick"));
    EXPECT_THAT(did_you_mean("PAPR", kPresets, "'"), test::Names("'paper'"));
    EXPECT_THAT(did_you_mean("trian", {"render", "train"}), test::Names("train"));
    EXPECT_THAT(did_you_mean("maen", {"sh", "mean"}), test::Names("mean"));
    EXPECT_THAT(did_you_mean("defualt", kPresets, "\""), test::Names("\"default\""));
    EXPECT_THAT(did_you_mean("iterations", {"train.iterations", "train.interval"}),
                test::Names("train.iterations"));
    EXPECT_THAT(did_you_mean("azimuth_ofset_deg", {"azimuth", "azimuth_offset_deg"}),
                test::Names("azimuth_offset_deg"));
}

TEST(DidYouMean, SaysNothingWhereNothingResembles) {
    EXPECT_EQ(did_you_mean("fast", kPresets), "");
    EXPECT_EQ(did_you_mean("fast", kPresets, "", ", expected a preset"), ", expected a preset");
    EXPECT_EQ(did_you_mean("", kPresets), "");
    EXPECT_EQ(did_you_mean("quick", {}), "");
}

}  // namespace
}  // namespace relidar
