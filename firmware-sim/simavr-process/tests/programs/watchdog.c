/* Sends the reset cause, then hangs with the watchdog enabled (64 ms). */
#include "uart.h"

register uint8_t reset_flags asm("r2");

int main(void)
{
	uint8_t flags = reset_flags;
	uart_begin();
	uart_send(flags);
	uart_send(MCUSR);
	wdt_enable(WDTO_60MS);
	wdt_reset();
	PORTB = 1 << 2;
	DDRB = 1 << 2;
	for (;;)
		;
}
