// SPDX-License-Identifier: Apache-2.0
// Every request must be answered under load, and no memory may leak.
#include <atomic>
#include <fstream>
#include <thread>

#include <unistd.h>

#include <gmock/gmock.h>

#include "small_service.hpp"
#include "support/names.hpp"

namespace relidar::serve {
namespace {

using Code = grpc::StatusCode;

double measure_resident_mib() {
    std::ifstream in("/proc/self/statm");
    double pages = 0.0, resident = 0.0;
    in >> pages >> resident;
    return resident * double(::sysconf(_SC_PAGESIZE)) / (1024.0 * 1024.0);
}

class Load : public ServiceTest {
protected:
    /// Sends calls from 8 clients, each with a separate connection.
    /// @return number of calls whose response contains this image
    int answered(int n_calls, const v1::RenderLidarRequest& request, const std::string& range_m) {
        std::atomic<int> next = 0, good = 0;
        std::vector<std::jthread> clients;
        for (int c = 0; c < 8; ++c)
            clients.emplace_back([&] {
                const auto mine = stub();
                while (next++ < n_calls) {
                    const auto [status, scan] = call(*mine, &Stub::RenderLidar, request);
                    good += status.ok() && scan.image().range_m() == range_m;
                }
            });
        clients.clear();
        return good;
    }
};

TEST_F(Load, ThousandCallsOfEightClientsAreAllAnsweredAndMemoryStays) {
    start();
    v1::RenderLidarRequest request = make_standing_request();
    request.mutable_sensor()->set_name("VLP-16:128x10");
    const v1::LidarScan truth = scan_of(request);
    const double answer_mib = double(truth.ByteSizeLong()) / (1024.0 * 1024.0);
    EXPECT_EQ(answered(200, request, truth.image().range_m()), 200);
    const double before_mib = measure_resident_mib();
    EXPECT_EQ(answered(1000, request, truth.image().range_m()), 1000);
    EXPECT_LT(measure_resident_mib() - before_mib, 0.25 * 1000 * answer_mib)
        << "a quarter of what is lost where each call leaves its answer behind: " << answer_mib
        << " MiB a call";
}

class Occupant {
public:
    explicit Occupant(v1::RenderService::Stub& stub) {
        v1::UploadSensorRequest upload;
        *upload.mutable_sensor() = make_rays_ahead(200'000);
        const std::string handle =
            serve::call(stub, &v1::RenderService::Stub::UploadSensor, upload).answer.handle();
        v1::RenderRigRequest request;
        *request.mutable_rig() = make_standing_request();
        request.mutable_rig()->clear_wanted();
        for (int i = 0; i < 64; ++i) {
            v1::RigSensor& sensor = *request.add_sensors();
            sensor.set_name(std::to_string(i));
            sensor.mutable_sensor()->set_handle(handle);
        }
        reader_ = stub.RenderRig(&context_, request);
        v1::RigScan first;
        EXPECT_TRUE(reader_->Read(&first)) << "it is in";
    }
    grpc::Status leave() {
        context_.TryCancel();
        return reader_->Finish();
    }

private:
    grpc::ClientContext context_;
    std::unique_ptr<grpc::ClientReader<v1::RigScan>> reader_;
};

grpc::Status render(v1::RenderService::Stub& stub,
                    std::chrono::milliseconds patience = std::chrono::seconds(60)) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + patience);
    v1::LidarScan scan;
    return stub.RenderLidar(&context, make_standing_request(), &scan);
}

TEST_F(Load, FullQueueTurnsAwayAndServesAgainWhenThereIsRoom) {
    start(1);  // two slots
    Occupant one(*calls), two(*calls);
    const grpc::Status status = render(*calls);
    EXPECT_EQ(status.error_code(), Code::RESOURCE_EXHAUSTED);
    EXPECT_THAT(status.error_message(), test::Names("queue ... 2"));
    EXPECT_EQ(one.leave().error_code(), Code::CANCELLED);
    EXPECT_EQ(two.leave().error_code(), Code::CANCELLED);
    grpc::Status after = render(*calls);
    // waits until the server has noticed
    for (int tries = 0; tries < 200 && after.error_code() == Code::RESOURCE_EXHAUSTED; ++tries) {
        std::this_thread::sleep_for(std::chrono::milliseconds(50));
        after = render(*calls);
    }
    EXPECT_TRUE(after.ok()) << after.error_message();
}

TEST_F(Load, DeadlinesAndLeavingClientsAreTheirOwn) {
    start(8);
    Occupant occupant(*calls);
    EXPECT_EQ(render(*calls, std::chrono::milliseconds(1)).error_code(), Code::DEADLINE_EXCEEDED);
    EXPECT_EQ(render(*calls, std::chrono::milliseconds(-1000)).error_code(), Code::DEADLINE_EXCEEDED)
        << "over before it began";
    for (int i = 0; i < 20; ++i) {  // cancels while a call is being processed
        grpc::ClientContext context;
        v1::LidarScan scan;
        std::jthread leaves([&] {
            std::this_thread::sleep_for(std::chrono::milliseconds(i));
            context.TryCancel();
        });
        const Code code = calls->RenderLidar(&context, make_standing_request(), &scan).error_code();
        EXPECT_TRUE(code == Code::CANCELLED || code == Code::OK) << code;
    }
    EXPECT_EQ(occupant.leave().error_code(), Code::CANCELLED);
    EXPECT_TRUE(render(*calls).ok());
}

TEST_F(Load, StopsWhileCallsAreInWork) {
    start(8);
    Occupant occupant(*calls);
    server->stop_and_wait(std::chrono::milliseconds(100));
    EXPECT_FALSE(occupant.leave().ok());
    EXPECT_EQ(render(*calls).error_code(), Code::UNAVAILABLE);
}

}  // namespace
}  // namespace relidar::serve
