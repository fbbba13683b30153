#include "bus_probe.h"

#include <gmock/gmock.h>

#include "../bus/bus_fixture.h"
#include "bus/error.h"

namespace splatbus::cli {
namespace {

using testing::HasSubstr;

std::string error_of(const bus::Address& address) {
  try {
    require_bus(address);
  } catch (const bus::Error& error) {
    return error.what();
  }
  return "no error";
}

class BusProbe : public bus_test::BusTest {};

TEST_F(BusProbe, FindsABus) {
  EXPECT_EQ(error_of(directory_.address()), "no error");
  EXPECT_EQ(error_of(broker_->tcp_address().value()), "no error");
}

TEST_F(BusProbe, SaysAtOnceThatThereIsNone) {
  const bus::Address tcp = broker_->tcp_address().value();
  broker_->stop();
  EXPECT_THAT(error_of(directory_.address()),
              testing::AllOf(HasSubstr("no bus at " + directory_.address().text()), HasSubstr("splatbus launch")));
  EXPECT_THAT(error_of(tcp), HasSubstr("no bus at " + tcp.text() + ": Connection refused"));
  const std::string nowhere = directory_.path() + "/nowhere";
  EXPECT_THAT(error_of(bus::Address::parse("ipc://" + nowhere)), HasSubstr("nothing runs there"));
  EXPECT_FALSE(std::filesystem::exists(nowhere)) << "looking makes no folder";
  EXPECT_THAT(error_of(bus::Address::parse("tcp://no.such.host.invalid:5000")),
              HasSubstr("no bus at tcp://no.such.host.invalid:5000: "));
}

TEST_F(BusProbe, WaitsNoLongerThanItIsToldTo) {
  broker_->stop();
  const auto start = std::chrono::steady_clock::now();
  const auto waits = [&](double seconds, const std::stop_token& stop) {
    require_bus(directory_.address(), std::chrono::duration<double>(seconds), stop);
  };
  EXPECT_THROW(waits(0.3, {}), bus::Error);
  EXPECT_GE(std::chrono::steady_clock::now() - start, std::chrono::milliseconds(300));
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THROW(waits(1e6, stop.get_token()), bus::Error) << "Ctrl-C ends it";
}

}  // namespace
}  // namespace splatbus::cli
