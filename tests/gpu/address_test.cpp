// SPDX-License-Identifier: Apache-2.0
// Arrays of different types cannot take each other's place in what a kernel is given, nor can kernels with other parameters. Most of it is
// whether something compiles.
#include <concepts>
#include <type_traits>

#include <relidar/stages/gpu.hpp>

#include "../support/device.hpp"
#include "gpu/kernel.hpp"
#include "shared/loss.h"

namespace relidar {
namespace {

static_assert(name_of_struct<shared::ImageLossParams>() == "ImageLossParams");
static_assert(params_of_kernel("loss/image_loss") == "ImageLossParams", "as its shader declares");
static_assert(params_of_kernel("loss/surfel_loss") != "ImageLossParams", "so Kernel<ImageLossParams> of it does not compile");
static_assert(params_of_kernel("loss/image_los").empty(), "nor does a name that no kernel has");

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
static_assert(!std::is_constructible_v<Address<float>, std::uint64_t> && !std::is_convertible_v<Address<float>, std::uint64_t>);
static_assert(std::same_as<decltype(Array<float>().address()), Address<float>>);
static_assert(sizeof(Address<float>) == 8 && std::is_trivially_copyable_v<Address<float>> && std::is_standard_layout_v<Address<float>>);

class AddressTest : public test::DeviceTest {};

TEST_F(AddressTest, NowhereIsWhatNoArrayHas) {
    const Array<glm::vec3> array(device(), 4, "test");
    const Address<glm::vec3> nowhere;
    EXPECT_NE(array.address(), nowhere);
    EXPECT_EQ(address_of(&array), array.address());
    EXPECT_EQ(address_of<glm::vec3>(nullptr), nowhere);
    EXPECT_EQ(Array<glm::vec3>().address(), nowhere);
    EXPECT_EQ(array.address_as<float>(1), array.address_as<float>(1));
    EXPECT_NE(array.address_as<float>(1), array.address_as<float>()) << "a part";
}

}  // namespace
}  // namespace relidar
