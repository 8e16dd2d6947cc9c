// SPDX-License-Identifier: Apache-2.0
// The compiler must reject arrays of the wrong type and parameters of the wrong kernel.
#include <concepts>

#include "diff/shared/accel.h"
#include "diff/shared/backward.h"
#include "diff/shared/bvh_build.h"
#include "diff/shared/densify.h"
#include "diff/shared/loss.h"
#include "diff/shared/optimizer.h"
#include "diff/shared/refine.h"
#include "gpu/kernel.hpp"
#include "gpu/shared/gpu.h"
#include "support/device.hpp"
#include "train/shared/train.h"

namespace relidar {
namespace {

static_assert(struct_name<shared::ImageLossParams>() == "ImageLossParams");
static_assert(params_name("diff/loss/image_loss") == "ImageLossParams", "as its shader declares");
static_assert(params_name("diff/loss/surfel_loss") != "ImageLossParams",
              "so Kernel<ImageLossParams> of it does not compile");
static_assert(params_name("loss/image_los").empty(), "nor does a name that no kernel has");

template <class Rendered, class Targets>
concept FillParameters = requires(Rendered rendered, Targets targets) {
    shared::ImageLossParams{.rendered = rendered, .targets = targets};
};

static_assert(FillParameters<Address<shared::RenderedRay>, Address<shared::DeviceTarget>>);
static_assert(!FillParameters<Address<shared::DeviceTarget>, Address<shared::RenderedRay>>, "swapped");
static_assert(!FillParameters<Address<shared::RenderedRay>, Address<float>>, "floats, of whatever");
static_assert(!FillParameters<Address<shared::RenderedRay>, std::uint64_t>, "a number");
static_assert(!FillParameters<Address<shared::RenderedRay>, int>, "0: nowhere is {}");

static_assert(!std::is_assignable_v<Address<float>&, Address<std::uint32_t>> &&
              !std::is_constructible_v<Address<float>, Address<std::uint32_t>>);
static_assert(!std::is_constructible_v<Address<float>, std::uint64_t> &&
              !std::is_convertible_v<Address<float>, std::uint64_t>);
static_assert(std::same_as<decltype(Array<float>().address()), Address<float>>);
static_assert(sizeof(Address<float>) == 8 && std::is_trivially_copyable_v<Address<float>> &&
              std::is_standard_layout_v<Address<float>>);

/// A call with swapped members would compile.
template <class Struct, class A, class B>
consteval bool are_interchangeable(A Struct::*, B Struct::*) {
    return std::is_assignable_v<A&, B> || std::is_assignable_v<B&, A>;
}

// Two pointers to the same type of number from each parameter header. tests/structure
// checks all structs.
static_assert(!are_interchangeable(&shared::ProxyParams::vertices, &shared::ProxyParams::boxes));
static_assert(!are_interchangeable(&shared::GatherParams::parts, &shared::GatherParams::d_records));
static_assert(!are_interchangeable(&shared::GatherParams::d_sh, &shared::GatherParams::d_records));
static_assert(!are_interchangeable(&shared::GatherParams::rows, &shared::GatherParams::slots));
static_assert(!are_interchangeable(&shared::PoseBlocksParams::d_view, &shared::PoseBlocksParams::sums));
static_assert(!are_interchangeable(&shared::BvhPointers::order, &shared::BvhPointers::roots));
static_assert(!are_interchangeable(&shared::BvhWideParams::queue, &shared::BvhWideParams::slots));
static_assert(!are_interchangeable(&shared::ClassifyParams::action, &shared::ClassifyParams::weight));
static_assert(!are_interchangeable(&shared::MoveParams::from, &shared::MoveParams::to));
static_assert(!are_interchangeable(&shared::ScanParams::counts, &shared::ScanParams::prefix));
static_assert(!are_interchangeable(&shared::RadixSortParams::keys, &shared::RadixSortParams::order));
static_assert(!are_interchangeable(&shared::ConvParams::weights, &shared::ConvParams::bias));
static_assert(!are_interchangeable(&shared::NormFinishParams::moments,
                                   &shared::NormFinishParams::scale_shift));
static_assert(!are_interchangeable(&shared::SsimParams::statistics, &shared::SsimParams::terms));
static_assert(!are_interchangeable(&shared::ChamferParams::simulated, &shared::ChamferParams::measured));
static_assert(!are_interchangeable(&shared::ChamferBoxesParams::low, &shared::ChamferBoxesParams::high));
static_assert(!are_interchangeable(&shared::AdamParams::values, &shared::AdamParams::gradients));
static_assert(!are_interchangeable(&shared::AdamParams::moment1, &shared::AdamParams::moment2));
static_assert(!are_interchangeable(&shared::DropLossParams::start, &shared::DropLossParams::target));
static_assert(!are_interchangeable(&shared::DropLossParams::logit, &shared::DropLossParams::d_logit));
static_assert(!are_interchangeable(&shared::SurfelPointers::log_scale, &shared::SurfelPointers::log_scale_w));
static_assert(!are_interchangeable(&shared::ActivateVjpParams::d_records,
                                   &shared::ActivateVjpParams::d_view));
static_assert(!are_interchangeable(&shared::TraceScene::pass_cap_count, &shared::TraceScene::visits));
static_assert(!are_interchangeable(&shared::BvhWideParams::demands, &shared::BvhWideParams::places));
static_assert(are_interchangeable(&shared::ActivateVjpParams::surfels, &shared::ActivateVjpParams::d_surfels),
              "gradients are arranged alike");

// Only address_as() and cast_tag() change the meaning of an array.
static_assert(
    std::same_as<decltype(Array<float, shared::LossTerms>().address()), Address<float, shared::LossTerms>>);
static_assert(!std::is_convertible_v<Address<float>, Address<float, shared::LossTerms>> &&
              !std::is_convertible_v<Address<float, shared::LossTerms>, Address<float>> &&
              !std::is_constructible_v<Address<float, shared::LossTerms>, Address<float>>);
static_assert(!std::is_constructible_v<Array<float, shared::LossTerms>, Array<float>>,
              "nor by way of a bare array");

class AddressTest : public test::DeviceTest {};

TEST_F(AddressTest, NowhereIsWhatNoArrayHas) {
    const Array<glm::vec3> array(device(), 4, "test");
    const Address<glm::vec3> nowhere;
    EXPECT_NE(array.address(), nowhere);
    EXPECT_EQ(address_or_null(&array), array.address());
    const Array<glm::vec3>* none = nullptr;
    EXPECT_EQ(address_or_null(none), nowhere);
    EXPECT_EQ(Array<glm::vec3>().address(), nowhere);
    EXPECT_EQ(array.address_as<float>(1), array.address_as<float>(1));
    EXPECT_NE(array.address_as<float>(1), array.address_as<float>()) << "a part";
    const Array<float, shared::LossTerms> terms(device(), 4, "test");
    EXPECT_EQ(terms.address(1).cast_tag<shared::SsimStatistics>(),
              (terms.address_as<float, shared::SsimStatistics>(1)));
}

}  // namespace
}  // namespace relidar
