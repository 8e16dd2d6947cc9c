// SPDX-License-Identifier: Apache-2.0
// Tests that kernels exchange values between threads only through coherent accesses. A
// GPU may answer other accesses from the cache of a subgroup.
#include "spirv_exchange.hpp"

#include <gmock/gmock.h>

#include "exchange_coherent.h"
#include "exchange_incoherent.h"
#include "gpu/kernel.hpp"

namespace relidar::structure {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAreArray;

TEST(Exchange, AccessesThatACacheMayAnswerAreFound) {
    EXPECT_THAT(find_incoherent_exchanges(exchange_incoherent), ElementsAre("keys"));
}
TEST(Exchange, CoherentOnesAreRight) { EXPECT_THAT(find_incoherent_exchanges(exchange_coherent), IsEmpty()); }

/// Kernels that have barriers but exchange no values. Each thread updates only its
/// elements. forward/sort_hits loads all values before its barriers and stores them after
/// its barriers.
struct OwnElements {
    const char* kernel;
    std::vector<std::string> members;
};
const OwnElements kOwnElements[] = {{"diff/accel/bvh_wide_scan", {"tiles"}},
                                    {"diff/forward/sort_hits", {"lists.hits"}},
                                    {"diff/loss/likelihood_loss", {"upstream"}},
                                    {"diff/loss/surfel_loss", {"d_surfels.mean"}},
                                    {"diff/network/conv", {"to.values"}}};

TEST(Exchange, NoKernelDoesSo) {
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        std::vector<std::string> allowed_members;
        for (const OwnElements& allowed : kOwnElements)
            if (kernel.name.substr(0, kernel.name.find('@')) == allowed.kernel)
                allowed_members = allowed.members;
        EXPECT_THAT(find_incoherent_exchanges(kernel.words), UnorderedElementsAreArray(allowed_members))
            << kernel.name
            << ": an exchange needs coherent accesses (diff/accel/bvh_forest.glsl); own elements a line in "
               "kOwnElements";
    }
}

}  // namespace
}  // namespace relidar::structure
