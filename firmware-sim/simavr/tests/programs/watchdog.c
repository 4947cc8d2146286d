/* Tells why it was started, then trusts the watchdog (64 ms) to a dead loop. */
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
