/* Reads nothing for 5 ms, then sends the overrun flag and the byte for each. */
#include "uart.h"
#include <util/delay.h>

int main(void)
{
	uart_begin();
	_delay_ms(5);
	for (;;) {
		while (!(UCSR0A & 1 << RXC0))
			;
		uint8_t status = UCSR0A;
		uint8_t byte = UDR0;
		uart_send(status & 1 << DOR0);
		uart_send(byte);
	}
}
