/*
 * Access to the fields of simavr's structures, which Rust can't declare.
 * All decisions are made in Rust.
 *
 * simavr 1.6 runs the instructions, the timers 0 and 2, the ADC and the
 * interrupt logic. "Owned" registers are served by Rust instead of by
 * simavr's module of that name, which stays idle; see mod.rs for the reasons.
 */
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_extint.h>
#include <simavr/avr_watchdog.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_core.h>

#define SMCR 0x53
#define RESPONSE 4
#define WAKE_UP 4

struct uno_callbacks {
	void *context;
	uint8_t (*read)(void *context, uint64_t now, uint16_t address);
	void (*write)(void *context, uint64_t now, uint16_t address, uint8_t value);
	void (*restart_watchdog)(void *context, uint64_t now);
	void (*log)(void *context, int fatal, const char *text);
	/* Set by a callback that Rust must process at once. */
	const volatile bool *changed;
};

struct uno_status {
	uint64_t cycle;
	uint32_t pc;
	/* Vector entered by this step, zero for none, and the cycles of the entry. */
	uint8_t entered;
	uint8_t response;
	/* Number of interrupts in service. */
	uint8_t depth;
	bool interrupts_enabled;
	bool asleep;
	bool crashed;
};

struct uno {
	avr_t *avr;
	struct uno_callbacks callbacks;
	avr_int_vector_t *vectors[32];
	struct {
		avr_io_write_t write;
		void *parameter;
	} watched[MAX_IOs];
};

/* simavr's logger has no context, and a process has one machine. */
static struct uno *the_machine;

static void logger(avr_t *avr, const int level, const char *format, va_list arguments)
{
	char text[256];
	(void)avr;
	if (level > LOG_WARNING || !the_machine)
		return;
	vsnprintf(text, sizeof(text), format, arguments);
	the_machine->callbacks.log(the_machine->callbacks.context, level <= LOG_ERROR, text);
}

static uint8_t owned_read(avr_t *avr, avr_io_addr_t address, void *parameter)
{
	struct uno *uno = parameter;
	return uno->callbacks.read(uno->callbacks.context, avr->cycle, address);
}

static void owned_write(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter)
{
	struct uno *uno = parameter;
	/* simavr reads the interrupt enable bits here. */
	avr->data[address] = value;
	uno->callbacks.write(uno->callbacks.context, avr->cycle, address, value);
}

static void watched_write(avr_t *avr, avr_io_addr_t address, uint8_t value, void *parameter)
{
	struct uno *uno = parameter;
	const avr_io_addr_t io = AVR_DATA_TO_IO(address);
	if (uno->watched[io].write)
		uno->watched[io].write(avr, address, value, uno->watched[io].parameter);
	else
		avr->data[address] = value;
	uno->callbacks.write(uno->callbacks.context, avr->cycle, address, value);
}

static int watchdog_ioctl(avr_io_t *io, uint32_t request, void *parameter)
{
	(void)io;
	(void)parameter;
	if (request != AVR_IOCTL_WATCHDOG_RESET)
		return -1;
	the_machine->callbacks.restart_watchdog(the_machine->callbacks.context, the_machine->avr->cycle);
	return 0;
}

static void no_sleep(avr_t *avr, avr_cycle_count_t cycles)
{
	(void)avr;
	(void)cycles;
}

static void report_status(const struct uno *uno, struct uno_status *status)
{
	const avr_t *avr = uno->avr;
	status->cycle = avr->cycle;
	status->pc = avr->pc;
	status->depth = avr->interrupts.running_ptr;
	status->interrupts_enabled = avr->sreg[S_I];
	status->asleep = avr->state == cpu_Sleeping;
	status->crashed = avr->state != cpu_Running && avr->state != cpu_Sleeping;
}

/* Runs timers that are due, then serves an interrupt if possible. */
static void settle(struct uno *uno, struct uno_status *status, int was_asleep)
{
	avr_t *avr = uno->avr;
	const uint8_t depth = avr->interrupts.running_ptr;
	status->entered = 0;
	status->response = 0;
	if (avr->cycle_timers.timer && avr->cycle_timers.timer->when <= avr->cycle)
		avr_cycle_timer_process(avr);
	if (avr->interrupt_state) {
		/* simavr delays interrupts by two instructions after SEI and RETI; the hardware by one. */
		if (avr->interrupt_state == -1)
			avr_service_interrupts(avr);
		avr_service_interrupts(avr);
	}
	if (avr->interrupts.running_ptr > depth) {
		status->entered = avr->interrupts.running[depth]->vector;
		status->response = RESPONSE + (was_asleep ? WAKE_UP : 0);
		/* simavr enters the vector in zero cycles. */
		avr->cycle += status->response;
	}
}

struct uno *uno_new(const struct uno_callbacks *callbacks, const uint8_t *flash, uint32_t size)
{
	struct uno *uno = calloc(1, sizeof(*uno));
	if (!uno)
		return NULL;
	uno->callbacks = *callbacks;
	the_machine = uno;
	avr_global_logger_set(logger);
	avr_t *avr = avr_make_mcu_by_name("atmega328p");
	if (!avr)
		return NULL;
	uno->avr = avr;
	avr_init(avr);
	avr->frequency = 16000000;
	avr->vcc = avr->avcc = avr->aref = 5000;
	avr->sleep = no_sleep;
	/* One instruction at a time. */
	avr->run_cycle_limit = 1;
	avr->run_cycle_count = 0;
	if (size > avr->flashend + 1)
		return NULL;
	memcpy(avr->flash, flash, size);
	avr->codeend = size;
	for (int i = 0; i < avr->interrupts.vector_count; i++) {
		avr_int_vector_t *vector = avr->interrupts.vector[i];
		if (vector->vector < 32)
			uno->vectors[vector->vector] = vector;
	}
	for (avr_io_t *io = avr->io_port; io; io = io->next)
		if (io->kind && !strcmp(io->kind, "watchdog"))
			io->ioctl = watchdog_ioctl;
	return uno;
}

/* Lets the callbacks serve reads of this register. */
void uno_own_read(struct uno *uno, uint16_t address)
{
	const avr_io_addr_t io = AVR_DATA_TO_IO(address);
	uno->avr->io[io].r.c = owned_read;
	uno->avr->io[io].r.param = uno;
}

/* Lets the callbacks serve writes of this register. */
void uno_own_write(struct uno *uno, uint16_t address)
{
	const avr_io_addr_t io = AVR_DATA_TO_IO(address);
	uno->avr->io[io].w.c = owned_write;
	uno->avr->io[io].w.param = uno;
}

/* Notifies the callbacks of writes of this register, which simavr serves. */
void uno_watch_write(struct uno *uno, uint16_t address)
{
	const avr_io_addr_t io = AVR_DATA_TO_IO(address);
	uno->watched[io].write = uno->avr->io[io].w.c;
	uno->watched[io].parameter = uno->avr->io[io].w.param;
	uno->avr->io[io].w.c = watched_write;
	uno->avr->io[io].w.param = uno;
}

/* Registers and I/O as after a reset; SRAM and the cycle stay. */
void uno_reset(struct uno *uno, struct uno_status *status)
{
	avr_t *avr = uno->avr;
	avr_reset(avr);
	/*
	 * A low pin while EICRA is zero, as after a reset, would start a poll that
	 * simavr does not end when the program then asks for edges.
	 */
	avr_extint_set_strict_lvl_trig(avr, EXTINT_IRQ_OUT_INT0, 0);
	avr->interrupt_state = 0;
	avr->interrupts.running_ptr = 0;
	avr->run_cycle_count = 0;
	status->entered = 0;
	status->response = 0;
	report_status(uno, status);
}

/*
 * Runs instructions up to the given cycle, or until an event:
 * an interrupt begins or ends, interrupts are enabled or disabled, the processor
 * sleeps or leaves the program, a device needs attention.
 */
void uno_run(struct uno *uno, uint64_t until, struct uno_status *status)
{
	avr_t *avr = uno->avr;
	const uint8_t depth = avr->interrupts.running_ptr;
	const uint8_t enabled = avr->sreg[S_I];
	do {
		/* One at a time. */
		avr->run_cycle_count = 0;
		avr->pc = avr_run_one(avr);
		/* Without the bit SE, SLEEP does nothing. */
		if (avr->state == cpu_Sleeping && !(avr->data[SMCR] & 1))
			avr->state = cpu_Running;
		settle(uno, status, 0);
	} while (avr->cycle < until && avr->state == cpu_Running && avr->pc < avr->codeend
		 && avr->interrupts.running_ptr == depth && avr->sreg[S_I] == enabled
		 && !*uno->callbacks.changed);
	report_status(uno, status);
}

/* Advances time without instructions, up to the given cycle or simavr's next timer. */
void uno_skip(struct uno *uno, uint64_t until, struct uno_status *status)
{
	avr_t *avr = uno->avr;
	const int was_asleep = avr->state == cpu_Sleeping;
	if (avr->sreg[S_I] && avr->interrupt_state) {
		avr->cycle += !was_asleep;
	} else {
		const avr_cycle_timer_slot_p timer = avr->cycle_timers.timer;
		uint64_t next = until;
		if (timer && timer->when < next)
			next = timer->when;
		if (next > avr->cycle)
			avr->cycle = next;
	}
	settle(uno, status, was_asleep);
	report_status(uno, status);
}

/* Skips time in which the processor is halted. */
void uno_set_cycle(struct uno *uno, uint64_t cycle)
{
	uno->avr->cycle = cycle;
}

/* Wakes the processor without an interrupt. */
void uno_wake(struct uno *uno)
{
	uno->avr->state = cpu_Running;
}

void uno_disable_interrupts(struct uno *uno)
{
	avr_sreg_set(uno->avr, S_I, 0);
}

/* Sets or clears the interrupt request of a device modelled in Rust. */
void uno_request(struct uno *uno, uint8_t number, int requested)
{
	avr_int_vector_t *vector = number < 32 ? uno->vectors[number] : NULL;
	if (!vector || vector->pending == !!requested)
		return;
	if (requested)
		avr_raise_interrupt(uno->avr, vector);
	else
		avr_clear_interrupt(uno->avr, vector);
}

/* Sets the level of the pin INT0. */
void uno_set_int0(struct uno *uno, int level)
{
	avr_irq_t *irq = avr_io_getirq(uno->avr, AVR_IOCTL_EXTINT_GETIRQ(), EXTINT_IRQ_OUT_INT0);
	if (irq)
		avr_raise_irq(irq, level);
}

/* Sets the voltage on the pin ADC0. */
void uno_set_adc0(struct uno *uno, uint32_t millivolts)
{
	avr_irq_t *irq = avr_io_getirq(uno->avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
	if (irq)
		avr_raise_irq(irq, millivolts);
}

/* Sets the supply, which is the converter's reference. */
void uno_set_supply(struct uno *uno, uint32_t millivolts)
{
	avr_t *avr = uno->avr;
	avr->vcc = avr->avcc = avr->aref = millivolts;
}

/* Registers, I/O and SRAM, with their size in bytes. */
uint8_t *uno_data(struct uno *uno, uint32_t *size)
{
	*size = uno->avr->ramend + 1u;
	return uno->avr->data;
}

/* Keeps simavr's output out of the messages on standard output. */
int uno_silence_stdout(void)
{
	return dup2(STDERR_FILENO, STDOUT_FILENO);
}
