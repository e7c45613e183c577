// Evaluates one formula with DyKnow, then monitors another one, and ends with its verdict.

#include <chrono>
#include <memory>

#include "dyknow_interfaces/action/monitor_formula.hpp"
#include "dyknow_interfaces/msg/exit_status.hpp"
#include "dyknow_interfaces/msg/formula_result.hpp"
#include "dyknow_interfaces/srv/evaluate_formula.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_action/rclcpp_action.hpp"

using dyknow_interfaces::action::MonitorFormula;
using dyknow_interfaces::msg::ExitStatus;
using dyknow_interfaces::msg::FormulaResult;
using dyknow_interfaces::srv::EvaluateFormula;
using namespace std::chrono_literals;

constexpr auto READY = "forall r in Rover: Charge[r] > 0.3";
constexpr auto STOPS =
  "forall r in Rover: always (Charge[r] < 0.2 -> eventually[0 s, 2 s] Speed[r] < 0.1)";

class Watch : public rclcpp::Node
{
public:
  Watch()
  : Node("watch")
  {
    evaluate_ =
      create_client<EvaluateFormula>("stream_reasoning_coordinator/evaluate_formula");
    monitor_ = rclcpp_action::create_client<MonitorFormula>(
      this, "stream_reasoning_coordinator/monitor_formula");
  }

  bool wait_for_dyknow()
  {
    return evaluate_->wait_for_service(10s) && monitor_->wait_for_action_server(10s);
  }

  void evaluate()
  {
    auto request = std::make_shared<EvaluateFormula::Request>();
    request->formula = READY;
    request->timeout.sec = 30;
    evaluate_->async_send_request(
      request, [this](rclcpp::Client<EvaluateFormula>::SharedFuture future) {
        const auto answer = future.get();
        report(*answer);
        monitor();
      });
  }

private:
  void monitor()
  {
    MonitorFormula::Goal goal;
    goal.formula = STOPS;
    goal.name = "stop_when_empty";
    goal.timeout.sec = 3600;
    rclcpp_action::Client<MonitorFormula>::SendGoalOptions options;
    options.feedback_callback =
      [this](auto, const std::shared_ptr<const MonitorFormula::Feedback> feedback) {
        RCLCPP_INFO_THROTTLE(
          get_logger(), *get_clock(), 5000, "%lu states, remaining formula: %s",
          static_cast<unsigned long>(feedback->states_progressed),
          feedback->residual_formula.c_str());
      };
    options.result_callback =
      [this](const rclcpp_action::ClientGoalHandle<MonitorFormula>::WrappedResult & wrapped) {
        // The result says more than the status of the action.
        const auto & result = wrapped.result;
        report(*result);
        rclcpp::shutdown();
      };
    monitor_->async_send_goal(goal, options);
  }

  // The response of the service and the result of the action have the same fields.
  template<typename AnswerT>
  void report(const AnswerT & answer)
  {
    if (answer.exit_status.code != ExitStatus::SUCCESS) {
      RCLCPP_ERROR(get_logger(), "no verdict: %s", answer.exit_status.message.c_str());
    } else {
      RCLCPP_INFO(
        get_logger(), "%s: %s", answer.verdict == FormulaResult::TRUE ? "true" : "false",
        answer.explanation.c_str());
    }
  }

  rclcpp::Client<EvaluateFormula>::SharedPtr evaluate_;
  rclcpp_action::Client<MonitorFormula>::SharedPtr monitor_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  auto node = std::make_shared<Watch>();
  if (!node->wait_for_dyknow()) {
    RCLCPP_ERROR(node->get_logger(), "DyKnow is not running");
    rclcpp::shutdown();
    return 2;
  }
  node->evaluate();
  rclcpp::spin(node);
  rclcpp::shutdown();
  return 0;
}
